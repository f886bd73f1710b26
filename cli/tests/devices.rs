//! Devices from the command line: emulators that other processes connect to, checks that say what is wrong, and a file
//! whose one line swaps a mock device, an emulated one and a real one.
#![cfg(feature = "devices")]
#![allow(clippy::unwrap_used, reason = "helpers of tests are not in test functions")]

use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::time::{Duration, Instant};

use serde_json::Value;

fn command(arguments: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_graspd"));
    command.args(arguments).env_remove("RUST_LOG").env_remove("GRASPD_SERVER");
    command
}

fn graspd(arguments: &[&str]) -> (bool, String, String) {
    let Output { status, stdout, stderr } = command(arguments).output().unwrap();
    (status.success(), String::from_utf8(stdout).unwrap(), String::from_utf8(stderr).unwrap())
}

fn example(name: &str) -> String {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../cell/examples").join(name);
    std::fs::read_to_string(path).unwrap()
}

/// A folder that goes with the test.
struct Folder(PathBuf);

impl Folder {
    fn new(name: &str) -> Self {
        let path = std::env::temp_dir().join(format!("graspd-devices-{name}-{}", std::process::id()));
        std::fs::create_dir_all(&path).unwrap();
        Self(path)
    }

    fn at(&self, name: &str) -> String {
        self.0.join(name).display().to_string()
    }

    fn write(&self, name: &str, text: &str) -> String {
        let path = self.at(name);
        std::fs::write(&path, text).unwrap();
        path
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        // What cannot be removed now is the system's to clean up.
        let _left = std::fs::remove_dir_all(&self.0);
    }
}

/// An emulator in a process of its own; it is asked to end when this is dropped.
struct Emulated {
    child: Child,
    lines: Vec<String>,
}

impl Emulated {
    fn start(arguments: &[&str]) -> Self {
        let child = command(&[&["emulate"], arguments].concat()).stdout(Stdio::piped()).spawn().unwrap();
        // From here on it ends with this.
        let mut emulated = Self { child, lines: Vec::new() };
        for line in BufReader::new(emulated.child.stdout.take().unwrap()).lines() {
            let line = line.unwrap();
            if line.starts_with("ready") {
                return emulated;
            }
            emulated.lines.push(line);
        }
        panic!("{arguments:?} is never ready: {:?}", emulated.lines);
    }

    /// The word after a name at the beginning of a line.
    fn told(&self, name: &str) -> String {
        let line = self.lines.iter().find_map(|line| line.strip_prefix(name));
        line.unwrap_or_else(|| panic!("no {name} in {:?}", self.lines)).trim().to_owned()
    }

    /// As ctrl-c does.
    fn interrupt(&mut self) -> std::process::ExitStatus {
        let asked = Command::new("kill").args(["-INT", &self.child.id().to_string()]).status().unwrap();
        assert!(asked.success());
        let until = Instant::now() + Duration::from_secs(10);
        loop {
            if let Some(status) = self.child.try_wait().unwrap() {
                return status;
            }
            assert!(Instant::now() < until, "it does not end");
            std::thread::sleep(Duration::from_millis(20));
        }
    }
}

impl Drop for Emulated {
    fn drop(&mut self) {
        // It may have ended.
        let _ended = self.child.kill();
        let _reaped = self.child.wait();
    }
}

fn findings(config: &str, name: &str) -> (bool, Vec<Value>) {
    let (good, stdout, stderr) = graspd(&["device", "check", "--config", config, name, "--json"]);
    let told: Value = serde_json::from_str(&stdout).unwrap_or_else(|e| panic!("{e}: {stdout}{stderr}"));
    (good, told["findings"].as_array().unwrap().clone())
}

fn bad(findings: &[Value]) -> Vec<&str> {
    findings.iter().filter(|f| f["ok"] == false).map(|f| f["subject"].as_str().unwrap()).collect()
}

#[test]
fn an_emulated_arm_is_checked_watched_and_ends_when_asked() {
    let folder = Folder::new("ur");
    let mut emulated = Emulated::start(&["ur", "--listen", "127.0.0.44", "--local"]);
    assert_eq!(emulated.told("rtde"), "127.0.0.44:30004");
    // The example, with its one line for the real device.
    let text =
        example("ur_robotiq_2f.toml").replacen("address = \"emulator\"", "address = \"127.0.0.44\"", 1);
    let config = folder.write("cell.toml", &text);
    let (good, found) = findings(&config, "arm");
    assert!(!good, "{found:?}");
    assert_eq!(bad(&found), ["remote control"]);
    let advice = found.iter().find(|f| f["ok"] == false).unwrap()["advice"].as_str().unwrap();
    assert!(advice.contains("Remote Control"), "{advice}");

    let (good, stdout, _) =
        graspd(&["device", "monitor", "arm", "--config", &config, "--count", "2", "--every", "0.1"]);
    assert!(good && stdout.matches("safety Normal").count() == 2, "{stdout}");
    assert!(!stdout.contains('\u{1b}'), "no terminal, no escape codes: {stdout}");
    assert!(emulated.interrupt().success());
    // Nobody is there any more, and that is said.
    let (good, found) = findings(&config, "arm");
    assert!(!good && bad(&found).contains(&"dashboard"), "{found:?}");
}

#[test]
fn an_emulated_gripper_is_found_by_each_of_its_addresses() {
    let folder = Folder::new("robotiq");
    let link = folder.at("gripper");
    let mut emulated = Emulated::start(&["robotiq", "--link", &link, "--fault", "fault=0x0e@0"]);
    assert_eq!(emulated.told("serial"), link);
    for address in [link.clone(), emulated.told("socket"), emulated.told("modbus "), emulated.told("rtu ")] {
        let text = example("ur_robotiq_2f.toml").replace("kind = \"ur\"", "kind = \"mock\"");
        let config = folder
            .write("cell.toml", &text.replace("address = \"emulator\"", &format!("address = \"{address}\"")));
        let (good, found) = findings(&config, "hand");
        assert!(!good, "{found:?}");
        assert_eq!(bad(&found), ["fault", "activation"], "{address}");
        let fault = found.iter().find(|f| f["subject"] == "fault").unwrap();
        assert_eq!(fault["found"], "fault 0x0e: over-current");
    }
    assert!(emulated.interrupt().success());
    assert!(!Path::new(&link).exists(), "the link is left behind");
}

#[test]
fn an_emulated_bus_is_checked_and_watched() {
    let folder = Folder::new("leap");
    let link = folder.at("leap");
    let mut emulated = Emulated::start(&["leap", "--link", &link, "--fault", "unplug=3@0"]);
    let text = example("ur_leap.toml").replace("address = \"emulator\"", &format!("address = \"{link}\""));
    // Machines of tests pause for long.
    let text = text.replace("reply_timeout_ms = 100", "reply_timeout_ms = 500");
    let config = folder.write("cell.toml", &text);
    let (good, found) = findings(&config, "hand");
    assert!(
        !good && found.iter().any(|f| f["found"].as_str().unwrap().contains("motor 3 (index_dip)")),
        "{found:?}"
    );
    assert!(emulated.interrupt().success());
    let mut emulated = Emulated::start(&["leap", "--link", &link]);
    let (good, found) = findings(&config, "hand");
    assert!(good && found.len() >= 18, "{found:?}");
    let (good, stdout, _) = graspd(&["device", "monitor", "hand", "--config", &config, "--count", "1"]);
    assert!(good && stdout.lines().filter(|l| l.contains("rad/s")).count() == 16, "{stdout}");
    assert!(emulated.interrupt().success());
}

#[test]
fn devices_are_listed_with_their_kinds_and_wrong_files_are_told() {
    let folder = Folder::new("list");
    let (good, stdout, _) = graspd(&["device", "list"]);
    assert!(good && stdout.contains("robotiq-3f") && stdout.contains("in the simulated world"), "{stdout}");
    let config = folder.write("cell.toml", &example("ur_leap.toml"));
    let (good, stdout, _) = graspd(&["device", "list", "--config", &config, "--json"]);
    let told: Value = serde_json::from_str(&stdout).unwrap();
    assert!(good && told["devices"][1]["kind"] == "ur" && told["devices"][1]["armed"] == true, "{told}");
    for (text, expected) in [
        (
            "[hand]\nkind = \"leep\"",
            "hand.kind: found \"leep\", expected one of mock, robotiq-2f, robotiq-3f, leap",
        ),
        ("[arm]\nkind = \"ur\"", "arm.address: found nothing, expected where the arm is"),
        (
            "[hand]\nkind = \"leap\"\naddress = \"/dev/ttyUSB0\"\n[hand.settings.leap]\ncurrent = 3",
            "hand.settings.leap: ",
        ),
        (
            "[camera]\nkind = \"pico-flexx\"\n[camera.settings.pico-flexx]\nretry_ms = 0",
            "retry_ms: found 0, expected 10 to 60000",
        ),
    ] {
        let config = folder.write("cell.toml", text);
        let (good, _, stderr) = graspd(&["device", "list", "--config", &config]);
        assert!(!good && stderr.contains(expected), "{stderr}\nshould contain\n{expected}");
    }
    let (good, _, stderr) = graspd(&["emulate", "ur", "--fault", "explode"]);
    assert!(!good && stderr.contains("expected one of protective-stop"), "{stderr}");
    let (good, stdout, _) = graspd(&["emulate", "leap", "--fault", "help"]);
    assert!(good && stdout.contains("overload=MOTOR[@AT]"), "{stdout}");
}

/// Each example names emulated devices; with one line less each is a mock, with another a real one.
#[test]
fn one_line_swaps_mock_emulated_and_real_devices() {
    let folder = Folder::new("swap");
    for (name, hand, real) in [
        ("ur_robotiq_2f.toml", "robotiq-2f", "socket://192.168.56.101:63352"),
        ("ur_robotiq_3f.toml", "robotiq-3f", "modbus://192.168.1.11:502"),
        ("ur_leap.toml", "leap", "/dev/ttyUSB0"),
    ] {
        let text = example(name);
        let kind = format!("kind = \"{hand}\"");
        assert_eq!(
            (text.matches(&kind).count(), text.matches("address = \"emulator\"").count()),
            (1, 2),
            "{name}"
        );
        let real = format!("address = \"{real}\"");
        let halves: Vec<&str> = text.splitn(3, "address = \"emulator\"").collect();
        let swapped = format!("{}address = \"emulator\"{}{real}{}", halves[0], halves[1], halves[2]);
        for (swap, told) in [
            (text.clone(), "emulated in this process"),
            (text.replace(&kind, "kind = \"mock\""), "in the simulated world"),
            (swapped, "armed"),
        ] {
            let config = folder.write("cell.toml", &swap);
            let (good, stdout, stderr) = graspd(&["device", "list", "hand", "--config", &config]);
            assert!(good && stdout.lines().nth(1).unwrap().contains(told), "{name}: {stdout}{stderr}");
        }
    }
}

#[cfg(feature = "sim")]
#[test]
fn nothing_moves_before_motion_is_armed() {
    let folder = Folder::new("armed");
    let text = example("ur_robotiq_2f.toml").replace("armed = true ", "armed = false ");
    let config = folder.write("cell.toml", &text);
    let (good, _, stderr) = graspd(&["cell", "run", &config]);
    assert!(!good && stderr.contains("motion is not armed for: arm, hand. Nothing has moved."), "{stderr}");
    assert!(stderr.contains("--arm-motion"), "{stderr}");
}
