"""The Helm chart: linted and rendered with several values, every resource held against Kubernetes' schema, and what refers
to something else in the chart to that."""

import subprocess
import sys
import tempfile
from pathlib import Path

import helm_python as helm
import kubernetes_validate
import yaml
from helm_python.chart import lint

from common import DEPLOY, GRASPD, accepts, clean_environment

CHART = DEPLOY / "helm" / "graspd"
# The oldest that the chart is meant for, and the newest that there is a schema of.
KUBERNETES = ["1.29", kubernetes_validate.latest_version()]
ERROR = 3

SETTINGS = """\
[limits]
calls_per_caller = 8

[[token]]
name = "arm"
role = "controller"
sha256 = "01af7e76d61a55f86ac4f975ac10936b4e8287058458f8233e6374cc02a24a5b"
"""

VALUES = {
    "defaults": {},
    "TLS and settings": {"front": {"tlsSecret": "graspd-tls", "settings": SETTINGS, "replicas": 3}},
    "a broker of one's own": {"broker": {"url": "tls://broker.example:4222"}},
    "a broker in a secret": {"broker": {"secret": {"name": "broker", "key": "address"}}},
    "callers, larger workers": {
        "worker": {"replicas": 8, "slots": 4},
        "networkPolicy": {"callers": [{"namespaceSelector": {"matchLabels": {"robots": "yes"}}}]},
    },
    "no policy": {"networkPolicy": {"enabled": False}},
}


def rendered(values: dict) -> list[dict]:
    with helm.Chart.load(str(CHART)) as chart:
        files = chart.render(values, name="demo", namespace="robots")
    texts = [text for path, text in sorted(files.items()) if path.endswith(".yaml")]
    return [doc for text in texts for doc in yaml.safe_load_all(text) if doc]


def pods(docs: list[dict]) -> list[dict]:
    return [d["spec"]["template"] for d in docs if d["kind"] in ("Deployment", "StatefulSet")]


def matches(selector: dict, labels: dict) -> bool:
    within = all(labels.get(k) == v for k, v in selector.get("matchLabels", {}).items())
    return within and all(
        e["operator"] == "In" and labels.get(e["key"]) in e["values"] for e in selector.get("matchExpressions", [])
    )


def check_references(docs: list[dict], expected_outside: set[str]) -> None:
    names = [(d["kind"], d["metadata"]["name"]) for d in docs]
    assert len(names) == len(set(names)), names
    templates = pods(docs)
    labels = [t["metadata"]["labels"] for t in templates]
    for doc in docs:
        where = f"{doc['kind']} {doc['metadata']['name']}"
        spec = doc.get("spec", {})
        if doc["kind"] in ("Deployment", "StatefulSet"):
            assert matches(spec["selector"], spec["template"]["metadata"]["labels"]), where
        if doc["kind"] == "Service":
            chosen = [t for t in templates if matches({"matchLabels": spec["selector"]}, t["metadata"]["labels"])]
            assert len(chosen) == 1, where
            ports = {p["name"] for c in chosen[0]["spec"]["containers"] for p in c["ports"]}
            assert {p["targetPort"] for p in spec["ports"]} <= ports, where
        if doc["kind"] == "NetworkPolicy":
            assert sum(matches(spec["podSelector"], own) for own in labels) == 1, where
            for peer in [p for rule in spec["ingress"] for p in rule.get("from", [])]:
                if "podSelector" in peer and peer["podSelector"]:
                    assert any(matches(peer["podSelector"], own) for own in labels), where
    outside = set()
    for template in templates:
        spec = template["spec"]
        volumes = {v["name"]: v for v in spec.get("volumes", [])}
        claims = {c["metadata"]["name"] for d in docs for c in d.get("spec", {}).get("volumeClaimTemplates", [])}
        for container in spec["containers"]:
            for mount in container["volumeMounts"] if "volumeMounts" in container else []:
                assert mount["name"] in volumes or mount["name"] in claims, mount
            for variable in container.get("env", []):
                secret = variable.get("valueFrom", {}).get("secretKeyRef")
                if secret:
                    outside.add(secret["name"])
        for volume in volumes.values():
            for kind, name in [("Secret", volume.get("secret", {}).get("secretName")),
                               ("ConfigMap", volume.get("configMap", {}).get("name"))]:
                if name and (kind, name) not in names:
                    outside.add(name)
    assert outside == expected_outside, (outside, expected_outside)


def check_programs(docs: list[dict], folder: Path) -> None:
    """What graspd and the broker say to their part of it."""
    for template in pods(docs):
        for container in template["spec"]["containers"]:
            security = container["securityContext"]
            assert security["readOnlyRootFilesystem"] and security["runAsNonRoot"], container["name"]
            if container["name"] != "nats":
                accepts(container["args"])
    for doc in docs:
        if doc["kind"] == "ConfigMap":
            path = folder / "nats.conf"
            path.write_text(doc["data"]["nats.conf"].replace("/var/lib/nats", str(folder)))
            broker = Path(sys.executable).parent / "nats-server"
            done = subprocess.run([broker, "-t", "-c", path], capture_output=True, text=True)
            assert done.returncode == 0, done.stderr
        if doc["kind"] == "Secret" and "graspd.toml" in doc["stringData"]:
            check_settings(doc["stringData"]["graspd.toml"] or "", folder)


def check_settings(text: str, folder: Path) -> None:
    """The settings start a server, with certificates where the chart puts some."""
    certificate, key = folder / "tls.crt", folder / "tls.key"
    if "[tls]" in text and not certificate.exists():
        subprocess.run(
            ["openssl", "req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:P-256", "-nodes", "-days", "1",
             "-subj", "/CN=front", "-keyout", key, "-out", certificate],
            check=True, capture_output=True,
        )
        key.chmod(0o600)
    path = folder / "graspd.toml"
    path.write_text(text.replace("/etc/graspd-tls", str(folder)))
    done = subprocess.run(
        [GRASPD, "doctor", "--config", path, "--listen", "127.0.0.1:0"],
        capture_output=True, text=True, env=clean_environment(), timeout=300,
    )
    assert done.returncode == 0, done.stdout + done.stderr


def check() -> str:
    resources = 0
    with tempfile.TemporaryDirectory() as folder:
        for name, values in VALUES.items():
            for version in KUBERNETES:
                report = lint(str(CHART), values, strict=True, kube_version=f"v{version}")
                found = [m for m in report["messages"] if m["severity"] >= ERROR]
                assert not found and not report["errors"], (name, found, report["errors"])
            docs = rendered(values)
            for doc in docs:
                for version in KUBERNETES:
                    kubernetes_validate.validate(doc, version, strict=True)
                resources += 1
            outside = {"graspd-tls"} if values.get("front", {}).get("tlsSecret") else set()
            if "secret" in values.get("broker", {}):
                outside.add("broker")
            check_references(docs, outside)
            check_programs(docs, Path(folder))
        # The checks themselves can fail.
        broken = rendered({})
        broken[0]["spec"]["replica"] = 1
        try:
            kubernetes_validate.validate(broken[0], KUBERNETES[0], strict=True)
        except kubernetes_validate.ValidationError:
            pass
        else:
            raise AssertionError("a misspelled field was not noticed")
    return f"{resources} resources of {len(VALUES)} sets of values are what Kubernetes {' and '.join(KUBERNETES)} take"
