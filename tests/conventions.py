"""Looks at a netCDF file for what the conventions CF and UGRID want of every variable."""

import netCDF4

WITHOUT_UNITS = ("cf_role", "geometry_type", "instance_dimension", "flag_values")
"""Attributes of meshes, identifiers, shapes, indices and flags, which measure nothing."""
NAMED_ELSEWHERE = ("coordinates", "mesh", "node_coordinates", "node_count", "face_node_connectivity")
"""Attributes that list other variables."""


def breaches(path):
    """Return what a file does against the conventions, one line for each; an empty list if nothing."""
    found = []
    with netCDF4.Dataset(path) as file:
        if not getattr(file, "Conventions", "").startswith("CF-1.11"):
            found.append("the attribute Conventions does not say CF-1.11")
        for name, variable in file.variables.items():
            has, text = variable.ncattrs(), variable.dtype is str
            if not {"long_name", "standard_name"} & set(has):
                found.append(f"{name} has neither a long_name nor a standard_name")
            if not (text or "units" in has or {*WITHOUT_UNITS} & set(has)):
                found.append(f"{name} has no units")
            if variable.dimensions == (name,) and {"_FillValue", "missing_value"} & set(has):
                found.append(f"{name} is the coordinate of a dimension and has a number for missing values")
            dated = " since " in getattr(variable, "units", "")
            if not dated and (getattr(variable, "axis", "") == "T" or getattr(variable, "standard_name", "") == "time"):
                found.append(f"{name} is said to be a time of CF, which needs a date")
            for attribute in {*NAMED_ELSEWHERE} & set(has):
                missing = [one for one in getattr(variable, attribute).split() if one not in file.variables]
                found += [f"{name} names {one} as {attribute}, which is not in the file" for one in missing]
    return found
