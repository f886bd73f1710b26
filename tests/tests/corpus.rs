//! Every parser of bytes from outside, on every input that fuzzing starts from: whole, cut off everywhere, and with bytes
//! changed. The functions are those of the fuzz targets in `fuzz/`, so that stable Rust runs them, too.
#![allow(clippy::unwrap_used, clippy::expect_used)] // Helpers of tests.

#[path = "../../fuzz/parsers.rs"]
mod parsers;

use std::path::{Path, PathBuf};

use rand::{RngExt, SeedableRng};
use rand_xoshiro::Xoshiro256PlusPlus;

/// Variants of an input that are tried: cuts, and inputs with changed bytes.
const CUTS: usize = 64;
const CHANGED: usize = 64;
/// Where parsers that take long on long inputs are tried with fewer variants, bytes.
const LONG: usize = 20_000;

type Parser = fn(&[u8]) -> bool;

const PARSERS: [(&str, Parser); 11] = [
    ("calibration", parsers::calibration),
    ("dashboard", parsers::dashboard),
    ("depth_frame", parsers::depth_frame),
    ("dynamixel", parsers::dynamixel),
    ("mkv", parsers::mkv),
    ("modbus_rtu", parsers::modbus_rtu),
    ("onnx", parsers::onnx),
    ("primary", parsers::primary),
    ("rosbridge", parsers::rosbridge),
    ("rtde", parsers::rtde),
    ("wrist_socket", parsers::wrist_socket),
];

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..")
}

fn files(folder: &Path) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(folder).unwrap_or_else(|e| panic!("{}: {e}", folder.display()));
    let mut files: Vec<PathBuf> = entries.map(|entry| entry.unwrap().path()).collect();
    files.sort();
    files
}

fn name(path: &Path) -> String {
    path.file_name().unwrap().to_string_lossy().into_owned()
}

/// The input, and what line noise makes of it.
fn tried(parser: Parser, input: &[u8]) {
    parser(input);
    let less = if input.len() > LONG { 8 } else { 1 };
    for cut in 0..CUTS / less {
        parser(&input[..input.len() * cut / (CUTS / less)]);
    }
    let mut random = Xoshiro256PlusPlus::seed_from_u64(input.len() as u64);
    for _ in 0..CHANGED / less {
        let mut changed = input.to_vec();
        for _ in 0..random.random_range(1..4usize) {
            if changed.is_empty() {
                break;
            }
            let at = random.random_range(0..changed.len());
            match random.random_range(0..4) {
                0 => changed[at] = random.random(),
                1 => changed[at] = [0, 0xFF, 0x7F, 0x80][random.random_range(0..4usize)],
                2 => drop(changed.remove(at)),
                _ => changed.insert(at, random.random()),
            }
        }
        parser(&changed);
    }
}

#[test]
fn every_fuzz_target_has_a_parser_and_inputs() {
    let targets: Vec<String> = files(&root().join("fuzz/fuzz_targets")).iter().map(|p| name(p)).collect();
    let expected: Vec<String> = PARSERS.iter().map(|(target, _)| format!("{target}.rs")).collect();
    assert_eq!(targets, expected);
    let folders: Vec<String> = files(&root().join("fuzz/corpus")).iter().map(|p| name(p)).collect();
    assert_eq!(folders, PARSERS.map(|(target, _)| target.to_owned()));
}

/// Inputs whose name begins with `good` are understood, those with `bad` are not; none makes a parser panic, whatever
/// becomes of it on its way.
#[test]
fn committed_inputs_are_understood_or_refused_and_never_more_than_that() {
    for (target, parser) in PARSERS {
        let mut understood = 0;
        for path in files(&root().join("fuzz/corpus").join(target)) {
            let input = std::fs::read(&path).unwrap();
            let found = parser(&input);
            let name = name(&path);
            if name.starts_with("good") {
                assert!(found, "{target}: {name} is not understood");
                understood += 1;
            } else if name.starts_with("bad") {
                assert!(!found, "{target}: {name} is taken for good");
            }
            tried(parser, &input);
        }
        // Whole networks are test data of the crate that reads them.
        assert!(understood > 0 || target == "onnx", "{target}: no good input");
    }
}

#[test]
fn networks_of_the_tests_are_understood_and_their_ruins_are_refused() {
    let mut understood = 0;
    for path in files(&root().join("inference/tests/models")) {
        if path.extension().is_some_and(|e| e == "onnx") {
            let input = std::fs::read(&path).unwrap();
            assert!(parsers::onnx(&input), "{}", path.display());
            tried(parsers::onnx, &input);
            understood += 1;
        }
    }
    assert!(understood > 0);
}
