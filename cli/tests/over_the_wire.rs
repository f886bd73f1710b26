//! A tray cleared by devices that are behind their wires: an emulated UR arm and an emulated Robotiq gripper, which move
//! the simulated world, with faults of links and devices in the middle of it.
#![cfg(feature = "sim")]
#![allow(clippy::unwrap_used, reason = "helpers of tests are not in test functions")]

use std::path::{Path, PathBuf};
use std::process::Command;

use serde_json::Value;

/// A folder that goes with the test.
struct Folder(PathBuf);

impl Folder {
    fn new() -> Self {
        let path = std::env::temp_dir().join(format!("graspd-wire-{}", std::process::id()));
        std::fs::create_dir_all(&path).unwrap();
        Self(path)
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        // What cannot be removed now is the system's to clean up.
        let _left = std::fs::remove_dir_all(&self.0);
    }
}

#[test]
fn a_tray_is_cleared_over_the_wire_in_spite_of_faults() {
    let folder = Folder::new();
    let example = Path::new(env!("CARGO_MANIFEST_DIR")).join("../cell/examples/ur_robotiq_2f.toml");
    let mut text = std::fs::read_to_string(example).unwrap();
    // Machines of tests pause for long: no fault but those that are asked for.
    text = text.replace("max_force_n = 235.0 ", "reply_timeout_ms = 500\nmax_force_n = 235.0 ");
    text.push_str(
        "\n[arm.settings.ur.heartbeat]\ntimeout_s = 0.8\n\n[arm.settings.ur.arrival]\nsettle_s = 20.0\n\n[simulation.wire_faults]\narm = [\"rtde:cut@4\", \
         \"protective-stop@9\", \"rtde:garble@20\"]\nhand = [\"mute=2@7\", \"garble=1@12\"]\n",
    );
    let config = folder.0.join("cell.toml");
    std::fs::write(&config, text).unwrap();
    // On the wall clock faults come wherever an arm is then: now and then one ends with something that presses on it, and a
    // person would have to look. No object may be lost then either; that the tray is cleared a second run may show.
    let (first, complaint) = run(&config, &folder.0.join("first"));
    let (summary, complaint, record) = match first {
        Ok(summary) => (summary, complaint, "first"),
        Err(summary) => {
            println!("not cleared at the first try: {summary}\n{complaint}");
            let (second, complaint) = run(&config, &folder.0.join("second"));
            let summary =
                second.unwrap_or_else(|summary| panic!("nor at the second: {summary}\n{complaint}"));
            (summary, complaint, "second")
        }
    };
    // The run ends because the tray is empty, not because a device is given up.
    let tally = &summary["report"]["tally"];
    assert_eq!((count(tally, "in_tray"), count(tally, "in_hand")), (0, 0), "{summary}");

    let record = folder.0.join(record);
    let attempts = std::fs::read_to_string(record.join("attempts.jsonl")).unwrap();
    assert!(attempts.contains("ProtectiveStop"), "the stop was met in no step: {complaint}\n{attempts}");
    // What the devices of the record are.
    let run = std::fs::read_to_string(record.join("run.json")).unwrap();
    assert!(run.contains("UR5e") && run.contains("robotiq"), "{run}");
}

fn count(tally: &Value, field: &str) -> u64 {
    tally[field].as_u64().unwrap()
}

/// One run: its summary, as an error where the tray was not cleared, and what it complained of. Every object is accounted for
/// in any case.
fn run(config: &Path, record: &Path) -> (Result<Value, Value>, String) {
    let output = Command::new(env!("CARGO_BIN_EXE_graspd"))
        .args(["cell", "run", "--objects", "2", "--trials", "8", "--json", "--record"])
        .args([record, config])
        .env_remove("RUST_LOG")
        .output()
        .unwrap();
    let complaint = String::from_utf8(output.stderr).unwrap();
    assert!(!complaint.contains("panicked"), "{complaint}");
    let summary: Value =
        serde_json::from_slice(&output.stdout).unwrap_or_else(|e| panic!("{e}: {complaint}"));
    let tally = &summary["report"]["tally"];
    let all =
        ["delivered", "lost", "in_tray", "in_hand"].map(|field| count(tally, field)).iter().sum::<u64>();
    assert_eq!(all, 2, "{summary}");
    let successes = count(tally, "successes");
    assert!(successes >= 1 && successes <= count(tally, "delivered"), "{summary}\n{complaint}");
    let is_cleared = output.status.success();
    (if is_cleared { Ok(summary) } else { Err(summary) }, complaint)
}
