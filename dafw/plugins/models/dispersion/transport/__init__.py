"""The transport of the gas by a given wind: advection and diffusion."""
