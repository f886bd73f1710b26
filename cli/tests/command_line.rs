//! The binary as a shell sees it: exit codes, what goes to which stream, and closed pipes.
#![allow(clippy::unwrap_used, reason = "helpers of tests are not in test functions")]

use std::io::Read as _;
use std::path::Path;
use std::process::{Command, Output, Stdio};

fn graspd(arguments: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_graspd"));
    command.args(arguments).env_remove("RUST_LOG").env_remove("GRASPD_SERVER");
    command
}

fn output(arguments: &[&str]) -> Output {
    graspd(arguments).output().unwrap()
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8(bytes.to_vec()).unwrap()
}

/// The frame that comes with graspd.
fn asset(name: &str) -> String {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("assets").join(name).display().to_string()
}

#[test]
fn hands_are_listed() {
    let output = output(&["hands", "list"]);
    assert!(output.status.success());
    let list = text(&output.stdout);
    for id in ["finray-2f", "robotiq-2f85", "robotiq-3f", "model-o", "finray-4f", "brunel", "leap"] {
        assert!(list.contains(id), "{id} in {list}");
    }
}

#[test]
fn a_plan_is_json_on_stdout_and_nothing_else() {
    let (depth, frame) = (asset("demo_depth.png"), asset("demo_frame.json"));
    let output = output(&[
        "plan",
        &depth,
        "--intrinsics",
        &frame,
        "--hand",
        "robotiq-2f85",
        "--batch",
        "16",
        "--json",
    ]);
    assert!(output.status.success(), "{}", text(&output.stderr));
    let value: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    let plan = &value["plans"][0];
    assert_eq!(plan["hand"], "robotiq-2f85");
    assert!(!plan["grasps"].as_array().unwrap().is_empty() || plan["no_grasp"].is_object());
}

#[test]
fn no_grasp_is_no_error_and_is_explained() {
    let (depth, frame) = (asset("demo_depth.png"), asset("demo_frame.json"));
    let output =
        output(&["plan", &depth, "--intrinsics", &frame, "--hand", "leap", "--target-point", "5,5,5,0.01"]);
    assert_eq!(output.status.code(), Some(0));
    let said = text(&output.stdout);
    assert!(said.contains("no grasp: target_not_found") && said.contains("nearest fix: "), "{said}");
}

#[test]
fn wrong_inputs_end_with_one_line_on_stderr() {
    let (depth, frame) = (asset("demo_depth.png"), asset("demo_frame.json"));
    let cases: [(&[&str], &str); 4] = [
        (
            &["plan", "none.png", "--intrinsics", &frame, "--hand", "leap"],
            "error: none.png: cannot be read: ",
        ),
        (&["plan", &frame, "--intrinsics", &frame, "--hand", "leap"], "expected a 16-bit grey PNG"),
        (&["plan", &depth, "--intrinsics", &depth, "--hand", "leap"], "expected a JSON object"),
        (&["plan", &depth, "--intrinsics", &frame, "--hand", "leep"], "did you mean \"leap\"?"),
    ];
    for (arguments, expected) in cases {
        let output = output(arguments);
        let said = text(&output.stderr);
        assert_eq!(output.status.code(), Some(1), "{arguments:?}");
        assert!(said.contains(expected) && said.trim_end().lines().count() == 1, "{said}");
        assert!(output.stdout.is_empty());
    }
}

#[test]
fn a_server_that_is_not_there_is_named() {
    let (depth, frame) = (asset("demo_depth.png"), asset("demo_frame.json"));
    // Port 1 of this machine: nobody serves there.
    let output =
        output(&["plan", &depth, "--intrinsics", &frame, "--hand", "leap", "--server", "http://127.0.0.1:1"]);
    assert_eq!(output.status.code(), Some(1));
    assert!(
        text(&output.stderr).contains("cannot connect to http://127.0.0.1:1"),
        "{}",
        text(&output.stderr)
    );
}

#[test]
fn a_closed_pipe_is_no_panic() {
    let mut child =
        graspd(&["hands", "show", "allegro"]).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    drop(child.stdout.take());
    let status = child.wait().unwrap();
    let mut said = String::new();
    child.stderr.take().unwrap().read_to_string(&mut said).unwrap();
    assert!(status.success(), "{said}");
    assert!(said.is_empty(), "{said}");
}

#[test]
fn shells_and_the_manual_know_the_commands() {
    for shell in ["bash", "zsh", "fish", "powershell", "elvish"] {
        let script = output(&["completions", shell]);
        assert!(script.status.success(), "{}", text(&script.stderr));
        let script = text(&script.stdout);
        assert!(script.contains("recalibrate") && script.contains("no-page"), "{shell}: {script}");
    }
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("completions");
    std::fs::create_dir_all(&folder).unwrap();
    // The shell itself says what it offers; a machine without it has nothing to ask. Bash is asked for a word of the
    // command, fish too; zsh offers nothing without a terminal, and reads its script.
    let offers = [
        (
            "bash",
            "source {}; _graspd graspd se graspd; COMP_WORDS=(graspd se) COMP_CWORD=1; _graspd graspd se graspd; echo ${COMPREPLY[*]}",
            "serve",
        ),
        ("fish", "source {}; complete -C 'graspd se'", "serve"),
        ("zsh", "zsh -n {} && echo it can be read", "it can be read"),
    ];
    for (shell, question, expected) in offers {
        let script = folder.join(format!("graspd.{shell}"));
        std::fs::write(&script, output(&["completions", shell]).stdout).unwrap();
        let question = question.replace("{}", &script.display().to_string());
        let Ok(asked) = Command::new(shell).args(["-c", &question]).output() else {
            eprintln!("not asked, for it is not installed: {shell}");
            continue;
        };
        let (said, error) = (text(&asked.stdout), text(&asked.stderr));
        assert!(asked.status.success() && said.contains(expected), "{shell}: {said}{error}");
    }
    let page = text(&output(&["man"]).stdout);
    assert!(page.contains(".TH graspd 1") && page.contains("graspd\\-serve(1)"), "{page}");
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("man");
    assert!(output(&["man", "--out", &folder.display().to_string()]).status.success());
    let serve = std::fs::read_to_string(folder.join("graspd-serve.1")).unwrap();
    assert!(serve.contains("no\\-page"), "{serve}");
}
