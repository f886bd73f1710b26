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

const PARSERS: [(&str, Parser); 13] = [
    ("calibration", parsers::calibration),
    ("dashboard", parsers::dashboard),
    ("depth_frame", parsers::depth_frame),
    ("dynamixel", parsers::dynamixel),
    ("hand", parsers::hand),
    ("mkv", parsers::mkv),
    ("modbus_rtu", parsers::modbus_rtu),
    ("onnx", parsers::onnx),
    ("primary", parsers::primary),
    ("request", parsers::request),
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

/// How long inputs are made up for; CI asks for minutes.
const SECONDS: &str = "GRASPD_FUZZ_SECONDS";
/// The seed of what is made up; a number that was printed makes the same inputs again.
const SEED: &str = "GRASPD_FUZZ_SEED";
/// Longest input that is made up, bytes.
const LONGEST: usize = 1 << 16;

/// An input made of others: cut, spliced, repeated, with bytes and numbers that parsers trip over.
fn made_up(inputs: &[Vec<u8>], random: &mut Xoshiro256PlusPlus) -> Vec<u8> {
    let mut made = inputs[random.random_range(0..inputs.len())].clone();
    for _ in 0..random.random_range(1..8usize) {
        let at = random.random_range(0..made.len() + 1);
        let to = (at + random.random_range(0..64usize)).min(made.len());
        match random.random_range(0..8) {
            0 if at < made.len() => made[at] ^= 1 << random.random_range(0..8u8),
            1 if at < made.len() => {
                made[at] = [0, 1, 0x7F, 0x80, 0xFF, b'"', b'\n', b'-'][random.random_range(0..8usize)]
            }
            2 => drop(made.drain(at..to)),
            3 => {
                let piece = made[at..to].to_vec();
                made.splice(at..at, piece);
            }
            4 => {
                let other = &inputs[random.random_range(0..inputs.len())];
                let from = random.random_range(0..other.len() + 1);
                made.truncate(at);
                made.extend_from_slice(&other[from..]);
            }
            // Lengths and counts that are lies, in either order of bytes.
            5 => {
                let number =
                    [0u32, 1, 0xFFFF, 0x7FFF_FFFF, 0xFFFF_FFFF, 0x8000_0000][random.random_range(0..6usize)];
                let bytes = if random.random() { number.to_le_bytes() } else { number.to_be_bytes() };
                let end = (at + 4).min(made.len());
                made.splice(at..end, bytes);
            }
            6 => made.insert(at, random.random()),
            _ => made.truncate(at),
        }
        made.truncate(LONGEST);
    }
    made
}

/// Fuzzing without a compiler's help: it sees no coverage, and it runs wherever tests do.
#[test]
fn inputs_that_are_made_up_make_no_parser_panic() {
    let number = |name: &str| std::env::var(name).ok().and_then(|text| text.parse::<u64>().ok());
    let seconds = number(SECONDS).unwrap_or(4) as f64;
    let now = std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH).unwrap();
    let seed = number(SEED).unwrap_or(now.as_secs());
    println!("{SEED}={seed}");
    let share = std::time::Duration::from_secs_f64(seconds / PARSERS.len() as f64);
    for (target, parser) in PARSERS {
        let folder = if target == "onnx" {
            "inference/tests/models".to_owned()
        } else {
            format!("fuzz/corpus/{target}")
        };
        let files = files(&root().join(folder));
        let inputs: Vec<Vec<u8>> = files.iter().map(|path| std::fs::read(path).unwrap()).collect();
        let mut random = Xoshiro256PlusPlus::seed_from_u64(seed);
        let (began, mut count, mut understood) = (std::time::Instant::now(), 0u64, 0u64);
        while count < 20 || began.elapsed() < share {
            let input = made_up(&inputs, &mut random);
            let found = std::panic::catch_unwind(|| parser(&input));
            let Ok(found) = found else {
                let path = std::env::temp_dir().join(format!("graspd-fuzz-{target}-{seed}-{count}"));
                std::fs::write(&path, &input).unwrap();
                panic!("{target} panics at input {count} of {SEED}={seed}, kept as {}", path.display());
            };
            (count, understood) = (count + 1, understood + u64::from(found));
        }
        println!("{target}: {count} inputs, {understood} understood");
    }
}

/// Writes inputs of requests anew: `cargo test -p graspd-tests --test corpus -- --ignored`.
#[test]
#[ignore = "writes into the corpus"]
fn requests_are_written() {
    use graspd_proto::v1;
    use prost::Message as _;

    let lens = v1::CameraIntrinsics { fx_px: 8.0, fy_px: 8.0, cx_px: 3.5, cy_px: 2.5, ..Default::default() };
    let frame = v1::DepthFrame {
        width_px: 8,
        height_px: 6,
        encoding: v1::DepthEncoding::RawU16.into(),
        depth_scale_m: 0.001,
        data: [244u8, 1].repeat(48).into(),
        intrinsics: Some(lens),
        ..Default::default()
    };
    let options = v1::PlanOptions { batch_size: 8, seed: 7, ..Default::default() };
    let plan = v1::PlanGraspsRequest {
        hand: "hands/leap".to_owned(),
        frames: vec![frame.clone()],
        options: Some(options.clone()),
        request_id: "a".to_owned(),
        ..Default::default()
    };
    let task = |id: &str| v1::HandTask {
        task_id: id.to_owned(),
        hand: "hands/robotiq-2f85".to_owned(),
        options: Some(options.clone()),
    };
    let hands = v1::PlanMultiHandRequest {
        frames: vec![frame.clone()],
        tasks: vec![task("left"), task("right")],
        ..Default::default()
    };
    let mut short = plan.clone();
    short.frames[0].data = vec![1, 2, 3].into();
    let stream = v1::StreamGraspsRequest { plan: Some(plan.clone()) };
    let nothing = v1::PlanMultiHandRequest { tasks: Vec::new(), ..hands.clone() };
    let folder = root().join("fuzz/corpus/request");
    for (name, method, message) in [
        ("good-plan", 0u8, plan.encode_to_vec()),
        ("good-stream", 1, stream.encode_to_vec()),
        ("good-several-hands", 2, hands.encode_to_vec()),
        ("bad-short-image", 0, short.encode_to_vec()),
        ("bad-no-tasks", 2, nothing.encode_to_vec()),
        ("bad-no-hand", 0, v1::PlanGraspsRequest { hand: String::new(), ..plan }.encode_to_vec()),
        ("bad-not-protobuf", 0, b"\xff\xff\xff\xff\xff\xff\xff\xff\xff\xff\xff".to_vec()),
    ] {
        std::fs::write(folder.join(name), [vec![method], message].concat()).unwrap();
    }
}
