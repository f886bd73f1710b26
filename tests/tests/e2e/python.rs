//! A client in another language: Python with grpcio, from stubs generated from the protocol's files.

use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use graspd_tests::TestServer;

const PACKAGES: [&str; 4] = ["grpcio", "grpcio-tools", "protobuf", "numpy"];
/// What reads recordings, and the schemas as their owner publishes them.
const READERS: [&str; 3] =
    ["mcap==1.6.0", "mcap-protobuf-support==0.6.0", "foxglove-schemas-protobuf==0.4.0"];

/// Signs in pip's output that it could not reach an index, rather than that something is wrong here.
const NO_NETWORK: [&str; 5] = [
    "NewConnectionError",
    "Temporary failure in name resolution",
    "Network is unreachable",
    "Connection refused",
    "ConnectTimeoutError",
];

/// Set to 1 where the test must run: then a missing Python or network is a failure.
pub(crate) const REQUIRED: &str = "GRASPD_REQUIRE_PYTHON";

pub(crate) fn required(value: Option<&str>) -> bool {
    value.is_some_and(|v| !matches!(v, "" | "0"))
}

#[test]
fn python_is_required_where_the_environment_says_so() {
    assert_eq!([None, Some(""), Some("0"), Some("1")].map(required), [false, false, false, true]);
}

fn run(command: &mut Command) -> Output {
    command.output().unwrap_or_else(|e| panic!("{command:?}: {e}"))
}

pub(crate) fn text(output: &Output) -> String {
    String::from_utf8_lossy(&[output.stdout.as_slice(), &output.stderr].concat()).into_owned()
}

/// Makes (or finds) the virtual environment; the reason why there is none.
pub(crate) fn environment(folder: &Path, packages: &[&str]) -> Result<PathBuf, String> {
    let python = folder.join("bin/python");
    let ready = folder.join("graspd-test-ready");
    if ready.exists() {
        return Ok(python);
    }
    match Command::new("python3").arg("--version").output() {
        Ok(found) if found.status.success() => {}
        _ => return Err("python3 is missing".to_owned()),
    }
    let made = run(Command::new("python3").args(["-m", "venv", "--clear"]).arg(folder));
    if !made.status.success() {
        // Some systems ship Python without venv or pip.
        return Err(format!("python3 -m venv fails: {}", text(&made).trim()));
    }
    let installed = run(Command::new(&python)
        .args(["-m", "pip", "install", "--quiet", "--disable-pip-version-check", "--retries", "1"])
        .args(packages));
    if !installed.status.success() {
        let said = text(&installed);
        assert!(NO_NETWORK.iter().any(|sign| said.contains(sign)), "{said}");
        return Err(format!("the network is missing: {}", said.lines().last().unwrap_or_default()));
    }
    std::fs::write(&ready, "").unwrap();
    Ok(python)
}

fn plan_with_python(endpoint: &str) -> Result<String, String> {
    let scratch = PathBuf::from(env!("CARGO_TARGET_TMPDIR"));
    let python = environment(&scratch.join("python-client"), &PACKAGES)?;
    let here = Path::new(env!("CARGO_MANIFEST_DIR"));
    let protocol = here.join("../proto");
    let stubs = scratch.join("python-stubs");
    std::fs::create_dir_all(&stubs).unwrap();
    let files = ["geometry", "frame", "options", "grasp", "assignment", "planner_service", "hand_service"];
    let generated = run(Command::new(&python)
        .args(["-m", "grpc_tools.protoc", "-I"])
        .arg(&protocol)
        .arg(format!("--python_out={}", stubs.display()))
        .arg(format!("--grpc_python_out={}", stubs.display()))
        .args(files.map(|f| format!("graspd/v1/{f}.proto"))));
    assert!(generated.status.success(), "{}", text(&generated));
    let planned = run(Command::new(&python)
        .arg(here.join("python/plan_client.py"))
        .arg(endpoint)
        .env("PYTHONPATH", &stubs));
    assert!(planned.status.success(), "{}", text(&planned));
    Ok(text(&planned))
}

#[tokio::test]
async fn a_python_client_plans() {
    let server = TestServer::start().await;
    let addr = server.addr.to_string();
    match tokio::task::spawn_blocking(move || plan_with_python(&addr)).await.unwrap() {
        Ok(said) => assert!(said.contains("all checks passed"), "{said}"),
        Err(reason) => {
            assert!(!required(std::env::var(REQUIRED).ok().as_deref()), "{REQUIRED} is set and {reason}");
            eprintln!("skipped: {reason}");
        }
    }
}

#[tokio::test]
async fn python_reads_a_recording_by_the_schemas_that_it_carries() {
    let scratch = crate::recording::Scratch::new();
    let server = TestServer::start_with(crate::recording::config(&scratch.0, 1.0)).await;
    let answers = crate::recording::call_all(&server).await;
    let success = graspd_client::ReportOutcomeRequest {
        plan_id: answers[0].plan_id.clone(),
        outcome: graspd_client::GraspOutcome::Success.into(),
        ..Default::default()
    };
    server.client().await.report_outcome(&success).await.unwrap();
    crate::recording::stop(server).await;
    let folder = scratch.0.clone();
    let read = move || -> Result<String, String> {
        let environments = PathBuf::from(env!("CARGO_TARGET_TMPDIR"));
        let python = environment(&environments.join("python-recording"), &READERS)?;
        let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("python/read_recording.py");
        let output = run(Command::new(&python).arg(script).arg(folder).args(["3", "1"]));
        assert!(output.status.success(), "{}", text(&output));
        Ok(text(&output))
    };
    match tokio::task::spawn_blocking(read).await.unwrap() {
        Ok(said) => assert!(said.contains("all checks passed"), "{said}"),
        Err(reason) => {
            assert!(!required(std::env::var(REQUIRED).ok().as_deref()), "{REQUIRED} is set and {reason}");
            eprintln!("skipped: {reason}");
        }
    }
}
