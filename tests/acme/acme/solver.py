"""Reads t, dt, n and n numbers; writes n numbers. Could be any language."""

import math
import os
import random
import sys

t, dt, n, *numbers = map(float, sys.stdin.read().split())
noise = random.Random(int(os.environ["DAFW_SEED"]))
for number in numbers:
    print(repr(number * math.exp(-float(sys.argv[1]) * dt) + noise.gauss(0.0, 0.01)))
