//! Recordings as a shell sees them: a server that is killed, and `graspd replay` and `recalibrate` afterwards.
#![allow(clippy::unwrap_used, reason = "helpers of tests are not in test functions")]

use std::io::{BufRead as _, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};

use graspd_client::{Client, ClientConfig, GraspOutcome, ReportOutcomeRequest};

fn graspd(arguments: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_graspd"));
    command.args(arguments).env_remove("RUST_LOG").env_remove("GRASPD_SERVER");
    command
}

fn run(arguments: &[&str]) -> (bool, String, String) {
    let Output { status, stdout, stderr } = graspd(arguments).output().unwrap();
    let text = |bytes| String::from_utf8(bytes).unwrap();
    (status.success(), text(stdout), text(stderr))
}

fn asset(name: &str) -> String {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("assets").join(name).display().to_string()
}

/// A server that is killed, not asked to end, when it is dropped.
struct Killed(Child);

impl Drop for Killed {
    fn drop(&mut self) {
        self.0.kill().unwrap();
        self.0.wait().unwrap();
    }
}

/// A server on a free port that says where it is in its log, which is JSON.
fn serve(folder: &str) -> (Killed, String, BufReader<std::process::ChildStderr>) {
    let flags = ["serve", "--listen", "127.0.0.1:0", "--log-format", "json", "--record", folder];
    let mut server = Killed(graspd(&flags).stderr(Stdio::piped()).spawn().unwrap());
    let mut log = BufReader::new(server.0.stderr.take().unwrap());
    let mut line = String::new();
    loop {
        line.clear();
        assert!(log.read_line(&mut line).unwrap() > 0, "the server has ended");
        let value: serde_json::Value = serde_json::from_str(&line).unwrap();
        if value["message"] == "serving" {
            let addr = value["local_addr"].as_str().unwrap();
            return (server, format!("http://{addr}"), log);
        }
    }
}

struct Scratch(PathBuf);

impl Drop for Scratch {
    fn drop(&mut self) {
        std::fs::remove_dir_all(&self.0).ok();
    }
}

#[test]
fn what_a_killed_server_has_recorded_plans_again() {
    let scratch =
        Scratch(Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("kill-{}", std::process::id())));
    let folder = scratch.0.display().to_string();
    let (server, url, mut log) = serve(&folder);
    let (depth, frame) = (asset("demo_depth.png"), asset("demo_frame.json"));
    let plan =
        ["plan", &depth, "--intrinsics", &frame, "--batch", "16", "--server", &url, "--hand", "robotiq-2f85"];
    let (planned, _, said) = run(&plan);
    assert!(planned, "{said}");
    // Another one records there: that is said, and nothing is overwritten.
    let (_, _, said) = run(&["serve", "--listen", "127.0.0.1:0", "--record", &folder]);
    assert!(said.contains("is in use by another process"), "{said}");
    // A call in the log: what it is, its trace, and nothing of its contents.
    let mut line = String::new();
    let value = loop {
        line.clear();
        assert!(log.read_line(&mut line).unwrap() > 0);
        let value: serde_json::Value = serde_json::from_str(&line).unwrap();
        if value["message"] == "call answered" && line.contains("PlanMultiHand") {
            break value;
        }
    };
    assert_eq!(value["span"]["trace_id"].as_str().unwrap().len(), 32, "{line}");

    // Report its grasp, by the id that the recording has for it: then it is written.
    let recorded = loop {
        let files = graspd_recording::files(&scratch.0).unwrap();
        let found = files.iter().flat_map(|file| graspd_recording::read_file(file).unwrap().plans).next();
        match found {
            Some(record) => break record,
            None => std::thread::sleep(std::time::Duration::from_millis(10)),
        }
    };
    let Some(graspd_proto::v1::hand_task_result::Outcome::Response(answer)) = &recorded.results[0].outcome
    else {
        panic!("no answer")
    };
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
    runtime.block_on(async {
        let client = Client::connect(ClientConfig::new(url)).await.unwrap();
        let report = ReportOutcomeRequest {
            plan_id: answer.plan_id.clone(),
            grasp_index: 0,
            outcome: GraspOutcome::Collision.into(),
            note: "touched the tray".to_owned(),
        };
        client.report_outcome(&report).await.unwrap();
    });
    // Not asked to end: killed.
    drop(server);

    let (equal, table, said) = run(&["replay", &folder, "--expect-equal"]);
    assert!(equal, "{table}{said}");
    assert!(table.contains("1 equal bit for bit") && table.contains("a file has no end"), "{table}");
    let (_, json, _) = run(&["replay", &folder, "--json"]);
    let json: serde_json::Value = serde_json::from_str(&json).unwrap();
    assert_eq!(
        (&json["summary"]["plans"], &json["plans"][0]["verdict"]),
        (&1.into(), &"equal".into()),
        "{json}"
    );
    let (_, outcomes, _) = run(&["replay", &folder, "--outcomes"]);
    assert!(outcomes.contains("collision") && outcomes.contains("touched the tray"), "{outcomes}");
    assert!(outcomes.contains("robotiq-2f85: 0 of 1 executed grasps succeeded"), "{outcomes}");
    let out = scratch.0.join("site.json").display().to_string();
    let (learned, _, said) = run(&["recalibrate", &folder, "--out", &out]);
    assert!(
        !learned && said.contains("found 1 with 0 successes and 1 failures, expected at least 30"),
        "{said}"
    );
    assert!(!Path::new(&out).exists());

    // The next server gives the file an end.
    drop(serve(&folder));
    let (_, table, _) = run(&["replay", &folder]);
    assert!(!table.contains("a file has no end"), "{table}");

    let (found, _, said) = run(&["replay", "/nowhere"]);
    assert!(!found && said.contains("/nowhere"), "{said}");
    let (found, _, said) = run(&["replay", &depth]);
    assert!(!found && said.contains("does not begin like an MCAP file"), "{said}");
}

#[test]
fn outcomes_become_a_calibration_that_a_server_takes() {
    use graspd_proto::v1;

    let scratch =
        Scratch(Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("learn-{}", std::process::id())));
    let (mut folder, _) = graspd_recording::Folder::open(&scratch.0, 32 << 20).unwrap();
    for i in 0..60u64 {
        let score = 0.3 + i as f64 / 100.0;
        // Higher scores succeed more often.
        let outcome = if (i * 7) % 60 < i { GraspOutcome::Success } else { GraspOutcome::LostLifting };
        let plan_id = graspd_recording::PlanId::new(i, [0; 10]).to_string();
        let report = |outcome: GraspOutcome| ReportOutcomeRequest {
            plan_id: plan_id.clone(),
            outcome: outcome.into(),
            ..Default::default()
        };
        // Of two reports for one grasp the last counts.
        for outcome in [GraspOutcome::NotExecuted, outcome] {
            let mut bundle = graspd_recording::Bundle::at(i);
            bundle.push_outcome(&v1::OutcomeRecord {
                report: Some(report(outcome)),
                hand: "hands/leap".to_owned(),
                uncalibrated_score: score,
                ..Default::default()
            });
            folder.write(i, &bundle).unwrap();
        }
    }
    drop(folder);
    let path = scratch.0.display().to_string();
    let out = scratch.0.join("site.json").display().to_string();
    let learn = ["recalibrate", &path, "--out", &out, "--name", "bench 3", "--hand", "leap"];
    let (learned, text, said) = run(&learn);
    assert!(learned && text.contains("bench 3: learned from 60 outcomes"), "{text}{said}");
    let (_, _, said) = run(&["recalibrate", &path, "--out", &out, "--hand", "allegro"]);
    assert!(said.contains("found 0 with 0 successes"), "{said}");
    let text = std::fs::read_to_string(&out).unwrap();
    let site = graspd_server::calibration::Calibration::parse(&text).unwrap();
    assert!(site.share(0.85) > site.share(0.35) + 0.2, "{text}");
    let (found, _, said) = run(&["doctor", "--calibration", &out, "--listen", "127.0.0.1:0"]);
    assert!(found, "{said}");
    std::fs::write(&out, text.replace("calibration/1", "calibration/9")).unwrap();
    let (found, _, said) = run(&["serve", "--calibration", &out, "--listen", "127.0.0.1:0"]);
    assert!(!found && said.contains("--calibration") && said.contains("graspd-calibration/1"), "{said}");
}
