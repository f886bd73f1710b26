//! The commands that need a simulated world, each run once on very little: what they count adds up, what they keep
//! can be executed and planned again, and files from outside end with an error, never with a panic.
#![cfg(feature = "sim")]
#![allow(clippy::unwrap_used, reason = "helpers of tests are not in test functions")]

use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use serde_json::Value;

fn graspd(arguments: &[&str]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_graspd"));
    command.args(arguments).env_remove("RUST_LOG").env_remove("GRASPD_SERVER").output().unwrap()
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8(bytes.to_vec()).unwrap()
}

/// What it printed; it must have ended well.
fn said(arguments: &[&str]) -> String {
    let output = graspd(arguments);
    assert!(output.status.success(), "{arguments:?}: {}", text(&output.stderr));
    text(&output.stdout)
}

/// What it complained of; it must have ended with an error, on one line.
fn refused(arguments: &[&str]) -> String {
    let output = graspd(arguments);
    let complaint = text(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{arguments:?}: {complaint}");
    assert!(complaint.starts_with("error: ") && complaint.trim_end().lines().count() == 1, "{complaint}");
    complaint
}

/// A folder that goes with the test.
struct Folder(PathBuf);

impl Folder {
    fn new(name: &str) -> Self {
        let path = std::env::temp_dir().join(format!("graspd-{name}-{}", std::process::id()));
        std::fs::create_dir_all(&path).unwrap();
        Self(path)
    }

    fn at(&self, name: &str) -> String {
        self.0.join(name).display().to_string()
    }

    fn json(&self, name: &str) -> Value {
        serde_json::from_str(&std::fs::read_to_string(self.0.join(name)).unwrap()).unwrap()
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        // What cannot be removed now is the system's to clean up.
        let _left = std::fs::remove_dir_all(&self.0);
    }
}

/// A box with these edges in millimetres, as OBJ.
fn cuboid(edges: [f64; 3]) -> String {
    let corner =
        |i: usize| (0..3).map(move |k| if i >> k & 1 == 1 { edges[k] / 2.0 } else { -edges[k] / 2.0 });
    let vertices = (0..8).map(|i| corner(i).fold("v".to_owned(), |line, c| format!("{line} {c}")) + "\n");
    let faces = ["1 5 7 3", "2 4 8 6", "1 2 6 5", "3 7 8 4", "1 3 4 2", "5 6 8 7"];
    vertices.chain(faces.map(|f| format!("f {f}\n"))).collect()
}

#[test]
fn eval_clear_counts_add_up_and_eval_look_sees_the_same_again() {
    let folder = Folder::new("clear");
    // One that the gripper takes, and one that is far wider than it opens.
    std::fs::create_dir(folder.0.join("meshes")).unwrap();
    std::fs::write(folder.0.join("meshes/a_box.obj"), cuboid([40.0, 60.0, 50.0])).unwrap();
    std::fs::write(folder.0.join("meshes/block.obj"), cuboid([140.0, 150.0, 160.0])).unwrap();
    let table = said(&[
        "eval",
        "clear",
        "--hands",
        "robotiq-2f85",
        "--items",
        "2",
        "--scenes",
        "single",
        "--give-up",
        "1",
        "--batch",
        "16",
        "--scheme",
        "60,12",
        "--jobs",
        "1",
        "--meshes",
        &folder.at("meshes"),
        "--mesh-scale",
        "0.001",
        "--json",
        &folder.at("all.json"),
        "--markdown",
        &folder.at("table.md"),
        "--failures",
        &folder.at("failed"),
    ]);
    assert!(table.contains("successes over attempts, empty plans included"), "{table}");
    assert!(std::fs::read_to_string(folder.0.join("table.md")).unwrap().contains("| Single"));
    let report = folder.json("all.json");
    let cell = &report["cells"][0];
    let count = |field: &str| cell[field].as_u64().unwrap();
    let runs = report["runs"].as_array().unwrap();
    let attempts: usize = runs.iter().map(|r| r["attempts"].as_array().unwrap().len()).sum();
    assert_eq!((runs.len(), count("items"), count("cleared")), (2, 2, 1));
    assert_eq!(count("trials") + count("empty_plans"), attempts as u64);
    let classes = cell["classes"].as_object().unwrap();
    assert_eq!(classes.values().map(|n| n.as_u64().unwrap()).sum::<u64>(), attempts as u64);
    let rate = cell["rate_of_attempts"]["rate"].as_f64().unwrap();
    assert!((rate - count("successes") as f64 / attempts as f64).abs() < 1e-12);

    // Every failure was kept, and ends the same.
    let failed = std::fs::read_dir(folder.0.join("failed")).unwrap();
    let failed: Vec<String> = failed.map(|f| f.unwrap().path().display().to_string()).collect();
    assert_eq!(failed.len() as u64, attempts as u64 - count("successes"));
    for file in &failed {
        let told = said(&["eval", "look", file]);
        assert!(told.contains("robotiq-2f85 in single run") && told.contains(", the same\n"), "{told}");
    }
}

#[test]
fn eval_look_draws_a_trial_and_refuses_what_no_world_is_made_of() {
    let folder = Folder::new("look");
    let pictured = Path::new(env!("CARGO_MANIFEST_DIR")).join("../docs/images/failures/lost_lifting.json");
    let told = said(&["eval", "look", &pictured.display().to_string(), "--out", &folder.at("strip.png")]);
    assert!(told.contains("now: lost while lifting, the same"), "{told}");
    let picture = std::fs::read(folder.0.join("strip.png")).unwrap();
    assert!(picture.starts_with(b"\x89PNG") && picture.len() > 50_000);

    let trial = std::fs::read_to_string(&pictured).unwrap();
    let changed = |change: &dyn Fn(&mut Value)| {
        let mut value: Value = serde_json::from_str(&trial).unwrap();
        change(&mut value);
        let file = folder.at("changed.json");
        std::fs::write(&file, value.to_string()).unwrap();
        refused(&["eval", "look", &file, "--plan"])
    };
    let message = changed(&|v| v["scene"]["settings"]["hands"]["turn_rad_s"] = (-1).into());
    assert!(message.contains("settings.hands.turn_rad_s: found -1, expected 0.001 to 100"), "{message}");
    let message = changed(&|v| v["scene"]["settings"]["contact_hz"] = (-200).into());
    assert!(message.contains("settings.contact_hz: found -200"), "{message}");
    let message = changed(&|v| v["batch"] = 1_000_000_000_000_u64.into());
    assert!(message.contains("batch: found 1000000000000, expected 1 to 16384"), "{message}");
    let message = changed(&|v| v["version"] = 1.into());
    assert!(message.contains("version: found 1, expected 2"), "{message}");
}

#[test]
fn eval_ap_grows_with_friction() {
    let folder = Folder::new("ap");
    let table = said(&[
        "eval",
        "ap",
        "--scenes",
        "1",
        "--views",
        "1",
        "--least",
        "2",
        "--most",
        "2",
        "--batch",
        "32",
        "--scheme",
        "60,12",
        "--volume",
        "tsdf",
        "--jobs",
        "1",
        "--json",
        &folder.at("ap.json"),
    ]);
    assert!(table.contains("AP_0.2") && table.contains("holds at some µ"), "{table}");
    let report = folder.json("ap.json");
    let volume = &report["volumes"][0];
    assert_eq!(volume["volume"], "tsdf");
    let by_friction = volume["precision"]["by_friction"].as_array().unwrap();
    let values: Vec<f64> = by_friction.iter().map(|pair| pair[1].as_f64().unwrap()).collect();
    assert_eq!(values.len(), 6);
    assert!(
        values.windows(2).all(|w| w[0] <= w[1]) && values.iter().all(|v| (0.0..=100.0).contains(v)),
        "{values:?}"
    );
    let ap = volume["precision"]["ap"].as_f64().unwrap();
    assert!((ap - values[..5].iter().sum::<f64>() / 5.0).abs() < 1e-9);
    assert!(refused(&["eval", "ap", "--hand", "leap"]).contains("hand: found leap with"));
}

#[test]
fn cell_run_records_what_cell_replay_plans_again() {
    let folder = Folder::new("cell");
    let record = folder.at("run");
    let output = graspd(&[
        "cell",
        "run",
        "--hand",
        "robotiq-2f85",
        "--objects",
        "1",
        "--trials",
        "2",
        "--record",
        &record,
        "--json",
    ]);
    let complaint = text(&output.stderr);
    assert!(!complaint.contains("panicked"), "{complaint}");
    let summary: Value =
        serde_json::from_slice(&output.stdout).unwrap_or_else(|e| panic!("{e}: {complaint}"));
    let tally = &summary["report"]["tally"];
    let count = |field: &str| tally[field].as_u64().unwrap();
    assert!(count("successes") <= count("trials") && count("trials") <= 2, "{summary}");
    let lines = folder.0.join("run/attempts.jsonl");
    let attempts = std::fs::read_to_string(&lines).unwrap();
    assert_eq!(attempts.lines().count() as u64, count("attempts"));
    assert_eq!(output.status.success(), !complaint.contains("the tray is not cleared"), "{complaint}");

    let again = said(&["cell", "replay", &record]);
    assert!(again.contains("attempt   1") && again.contains(": the same"), "{again}");

    // A line that was being written when the run was killed is left out, and told.
    std::fs::write(&lines, format!("{attempts}{}", &attempts[..30])).unwrap();
    let output = graspd(&["cell", "replay", &record, "--json"]);
    assert!(output.status.success(), "{}", text(&output.stderr));
    let note = format!("attempts.jsonl: line {} was cut off", attempts.lines().count() + 1);
    assert!(text(&output.stderr).contains(&note), "{}", text(&output.stderr));
    assert!(text(&output.stdout).lines().all(|line| line.contains("\"same\":true")));

    // What the file of the run says is checked like any configuration.
    let mut run = folder.json("run/run.json");
    run["config"]["timeouts"]["plan_s"] = (-1).into();
    std::fs::write(folder.0.join("run/run.json"), run.to_string()).unwrap();
    let message = refused(&["cell", "replay", &record]);
    assert!(message.contains("timeouts.plan_s: found -1"), "{message}");
}

#[test]
fn dataset_is_generated_goes_on_where_it_stopped_and_is_drawn_and_counted() {
    let folder = Folder::new("dataset");
    std::fs::write(folder.0.join("recipe.json"), r#"{"objects": [2, 3], "places": [30, 80]}"#).unwrap();
    let (out, recipe) = (folder.at("data"), folder.at("recipe.json"));
    let arguments = |seed| {
        let fixed = ["dataset", "generate", "--scenes", "4", "--views", "2", "--sensor", "pico-flexx"];
        [&fixed[..], &["--shard", "1/2", "--jobs", "2", "--seed", seed, "--recipe", &recipe, "--out", &out]]
            .concat()
    };
    let done = said(&arguments("1"));
    assert!(done.contains("contacts-00001-of-00002.gcd: 4 views of 2 scenes"), "{done}");
    let path = folder.0.join("data/contacts-00001-of-00002.gcd");
    let whole = std::fs::read(&path).unwrap();
    // Interrupted in its last record.
    std::fs::write(&path, &whole[..whole.len() - 1000]).unwrap();
    said(&arguments("1"));
    assert!(std::fs::read(&path).unwrap() == whole, "it did not go on to the same bytes");
    let complaint = refused(&arguments("2"));
    assert!(complaint.contains("made with seed 1"), "{complaint}");
    assert!(std::fs::read(&path).unwrap() == whole, "a refused shard was changed");

    let shard = path.display().to_string();
    let picture = folder.at("sample.png");
    let about = said(&["dataset", "look", &shard, "3", "--out", &picture]);
    assert!(about.starts_with("scene 3, view 1: "), "{about}");
    assert!(std::fs::read(&picture).unwrap().starts_with(b"\x89PNG"));
    assert!(refused(&["dataset", "look", &shard, "4", "--out", &picture]).contains("record: found 4"));

    let counts = folder.at("counts.json");
    let table = said(&["dataset", "stats", &out, "--json", &counts]);
    assert!(table.contains("scenes, views                              2, 4"), "{table}");
    let counts = folder.json("counts.json");
    assert!(counts["contacts"].as_u64() > Some(100) && counts["contacts_in_occupied"] == 0, "{counts}");
    // Nothing in it: not sane.
    std::fs::create_dir(folder.0.join("empty")).unwrap();
    let path = folder.0.join("empty/begun.gcd");
    let header = 16 + u32::from_le_bytes(whole[8..12].try_into().unwrap()) as usize;
    std::fs::write(&path, &whole[..header]).unwrap();
    assert!(refused(&["dataset", "stats", &folder.at("empty")]).contains("views: found 0"));
    assert!(refused(&["dataset", "stats", &folder.at("nowhere")]).contains("nowhere"));
}

#[test]
fn a_dataset_of_meshes_holds_every_fourth_out() {
    let folder = Folder::new("dataset-meshes");
    std::fs::create_dir(folder.0.join("meshes")).unwrap();
    for (name, height) in [("a", 40.0), ("b", 50.0), ("c", 60.0), ("d", 70.0)] {
        std::fs::write(folder.0.join(format!("meshes/{name}.obj")), cuboid([30.0, 50.0, height])).unwrap();
    }
    std::fs::write(folder.0.join("recipe.json"), r#"{"objects": [2, 2], "places": [30, 80]}"#).unwrap();
    let (meshes, recipe) = (folder.at("meshes"), folder.at("recipe.json"));
    for (split, names) in [("train", r#""objects":["a","b","c"]"#), ("held-out", r#""objects":["d"]"#)] {
        let out = folder.at(split);
        said(&[
            "dataset",
            "generate",
            "--out",
            &out,
            "--scenes",
            "1",
            "--views",
            "1",
            "--sensor",
            "ideal",
            "--recipe",
            &recipe,
            "--meshes",
            &meshes,
            "--mesh-scale",
            "0.001",
            "--families",
            split,
        ]);
        let bytes = std::fs::read(folder.0.join(split).join("contacts-00000-of-00001.gcd")).unwrap();
        let header = String::from_utf8_lossy(&bytes[16..2000.min(bytes.len())]).into_owned();
        assert!(header.contains(names), "{header}");
    }
}
