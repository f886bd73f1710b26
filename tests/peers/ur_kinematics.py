"""Table of forward and inverse kinematics by ur-analytic-ik, an independent implementation (C++).

Prints one line a posture: model, six joints, the upper three rows of the flange's pose (row major), and all
postures of the inverse, flattened, sorted. The committed table is adapters/ur/tests/golden/kinematics.tsv.
"""

import importlib.metadata
import random

import ur_analytic_ik

VERSION = importlib.metadata.version("ur_analytic_ik")
MODELS = ("ur3", "ur5", "ur10", "ur3e", "ur5e", "ur10e", "ur16e")


def main() -> None:
    print(f"# ur-analytic-ik {VERSION}: model, joints (6), pose rows (12), branches of the inverse (6 each)")
    rng = random.Random(5)
    for name in MODELS:
        model = getattr(ur_analytic_ik, name)
        for _ in range(8):
            joints = [round(rng.uniform(-3.1, 3.1), 6) for _ in range(6)]
            pose = model.forward_kinematics(*joints)
            branches = sorted([float(v) for v in branch] for branch in model.inverse_kinematics(pose))
            numbers = joints + [float(v) for v in pose[:3].flatten()] + [v for branch in branches for v in branch]
            print("\t".join([name] + [format(v, ".12g") for v in numbers]))


if __name__ == "__main__":
    main()
