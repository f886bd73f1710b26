"""Compose files: held against the Compose specification, graspd's arguments against graspd, files that are mounted against
those that there are."""

import yaml
from compose_spec.models import ComposeSpecification, Service
from pydantic import ValidationError

from common import DEPLOY, accepts

# What the operator brings.
BROUGHT = {"./etc"}


def validate(file: dict) -> None:
    """By the specification's own model, which takes keys that it does not know: those are looked for besides."""
    ComposeSpecification.model_validate(file)
    for what, model in [(file, ComposeSpecification), *((spec, Service) for spec in file["services"].values())]:
        known = {field.alias or name for name, field in model.model_fields.items()} | set(model.model_fields)
        unknown = set(what) - known
        assert not unknown, f"no keys of the Compose specification: {sorted(unknown)}"


def check() -> str:
    services = 0
    for name in ["compose.yml", "compose-several.yml"]:
        file = yaml.safe_load((DEPLOY / name).read_text())
        file = {k: v for k, v in file.items() if not k.startswith("x-")}
        validate(file)
        for service, spec in file["services"].items():
            services += 1
            where = f"{name}: {service}"
            is_ours = "build" in spec
            if is_ours:
                assert (DEPLOY / spec["build"]["context"] / spec["build"]["dockerfile"]).exists(), where
                if "command" in spec:
                    accepts(spec["command"])
                assert spec["read_only"] and spec["cap_drop"] == ["ALL"], where
            for volume in spec.get("volumes", []):
                source = volume.split(":")[0]
                if source.startswith("."):
                    assert source in BROUGHT or (DEPLOY / source).exists(), f"{where}: {source}"
                else:
                    assert source in file.get("volumes", {}), f"{where}: {source}"
            for other in spec.get("depends_on", []):
                assert other in file["services"], f"{where}: {other}"
            for network in spec.get("networks", []):
                assert network in file["networks"], f"{where}: {network}"
        # Nothing but loopback is opened, but for the one port of a server that has certificates.
        opened = {p for spec in file["services"].values() for p in spec.get("ports", [])}
        assert all(p.startswith("127.0.0.1:") for p in opened - {"50051:50051"}), opened
    for broken in [{"image": "b", "prots": ["1:1"]}, {"image": "b", "ports": 7}]:
        try:
            validate({"services": {"a": broken}})
        except (AssertionError, ValidationError):
            continue
        raise RuntimeError(f"{broken} was taken for a service")
    return f"{services} services are what the Compose specification says"
