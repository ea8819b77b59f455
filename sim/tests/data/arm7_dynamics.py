"""Reference values for the arm's dynamics, from an independent implementation.

Pinocchio (Carpentier et al. 2019; `pip install pin==4.1.0`) reads ../../assets/arm7.urdf and gives, at random
states, the mass matrix (CRBA), the bias forces under gravity (RNEA without acceleration) and the accelerations
under random forces (ABA). No rotor inertia. Degrees of freedom: the seven joints (rad), the left finger, the right
finger (m). It knows no capsules, but shapes have no part in dynamics: the model is read without geometry.

    python arm7_dynamics.py > arm7_dynamics.toml
"""

import random
from pathlib import Path

import numpy as np
import pinocchio as pin

URDF = Path(__file__).resolve().parents[2] / "assets" / "arm7.urdf"
STATES = 12


def main() -> None:
    model = pin.buildModelFromUrdf(str(URDF))
    data = model.createData()
    assert [str(name) for name in model.names[8:]] == ["left_finger_joint", "right_finger_joint"]
    draw = random.Random(20261122)
    numbers = lambda values: "[" + ", ".join(repr(float(v)) for v in values) + "]"
    print(f"# Made by arm7_dynamics.py with Pinocchio {pin.__version__}: do not edit.")
    for _ in range(STATES):
        low, high = model.lowerPositionLimit, model.upperPositionLimit
        q = np.array([draw.uniform(a, b) for a, b in zip(low, high)])
        v = np.array([draw.uniform(-2, 2) for _ in range(7)] + [draw.uniform(-0.2, 0.2) for _ in range(2)])
        force = np.array([draw.uniform(-80, 80) for _ in range(7)] + [draw.uniform(-20, 20) for _ in range(2)])
        mass = pin.crba(model, data, q)
        mass = np.triu(mass) + np.triu(mass, 1).T
        bias = pin.nonLinearEffects(model, data, q, v)
        acceleration = pin.aba(model, data, q, v, force)
        print("\n[[state]]")
        print("q =", numbers(q))
        print("speed =", numbers(v))
        print("force =", numbers(force))
        print("mass_lower =", numbers(mass[i, j] for i in range(9) for j in range(i + 1)))
        print("bias =", numbers(bias))
        print("acceleration =", numbers(acceleration))


main()
