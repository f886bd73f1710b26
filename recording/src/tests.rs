//! Tests of recordings: what is written comes back, within its budget, after every kind of end.

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU32, Ordering};

use graspd_proto::v1;
use graspd_proto::v1::plan_record::Request;

use super::*;

/// A folder of its own for a test; removed at its end.
struct Scratch(PathBuf);

impl Scratch {
    fn new() -> Self {
        static COUNT: AtomicU32 = AtomicU32::new(0);
        let n = COUNT.fetch_add(1, Ordering::Relaxed);
        let path = std::env::temp_dir().join(format!("graspd-recording-{}-{n}", std::process::id()));
        fs::create_dir_all(&path).unwrap();
        Self(path)
    }
}

impl Drop for Scratch {
    fn drop(&mut self) {
        fs::remove_dir_all(&self.0).ok();
    }
}

fn id(n: u8) -> PlanId {
    PlanId::new(1_800_000_000_000 + u64::from(n), [n; 10])
}

/// Bytes that do not repeat (splitmix64).
fn noise(seed: u64, bytes: usize) -> bytes::Bytes {
    let byte = |i: usize| {
        let mut z = (seed << 32 | i as u64).wrapping_mul(0x9e37_79b9_7f4a_7c15);
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        (z >> 24) as u8
    };
    (0..bytes).map(byte).collect()
}

/// A call with two raw frames and a PNG.
fn record(n: u8) -> v1::PlanRecord {
    let frame = |encoding: v1::DepthEncoding, bytes: usize| v1::DepthFrame {
        width_px: 32,
        height_px: 16,
        encoding: encoding.into(),
        data: noise(u64::from(n) << 8 | encoding as u64, bytes),
        ..Default::default()
    };
    let answer = v1::PlanGraspsResponse {
        plan_id: id(n).to_string(),
        grasps: vec![v1::Grasp { score: 0.75, uncalibrated_score: 0.5, ..Default::default() }],
        stats: Some(v1::PlanStats { hand: "hands/leap".to_owned(), ..Default::default() }),
        ..Default::default()
    };
    v1::PlanRecord {
        server_version: "0".to_owned(),
        request: Some(Request::PlanGrasps(v1::PlanGraspsRequest {
            hand: "hands/leap".to_owned(),
            frames: vec![
                frame(v1::DepthEncoding::RawU16, 1024),
                frame(v1::DepthEncoding::PngU16, 100),
                frame(v1::DepthEncoding::RawF32, 2048),
            ],
            ..Default::default()
        })),
        results: vec![v1::HandTaskResult {
            task_id: String::new(),
            outcome: Some(v1::hand_task_result::Outcome::Response(answer)),
        }],
        ..Default::default()
    }
}

fn bundle(n: u8) -> Bundle {
    let mut bundle = Bundle::at(1_800_000_000_000_000_000 + u64::from(n));
    bundle.push_plan(record(n));
    bundle
}

fn outcome(n: u8) -> v1::OutcomeRecord {
    v1::OutcomeRecord {
        report: Some(v1::ReportOutcomeRequest { plan_id: id(n).to_string(), ..Default::default() }),
        uncalibrated_score: 0.5,
        ..Default::default()
    }
}

#[test]
fn what_is_not_wanted_is_offered_and_not_made() {
    let depth = depth_topic(0);
    let mut some = Bundle::only(7, [depth.clone(), "/none".to_owned()].into());
    some.push_plan(record(1));
    some.add("/other", Schema::PlanStats, || -> v1::PlanStats { panic!("made") });
    some.add("/other", Schema::PlanStats, || -> v1::PlanStats { panic!("made") });
    let offered: Vec<&str> = some.offered().iter().map(|(topic, _)| topic.as_str()).collect();
    assert_eq!(offered, ["/camera/0/depth", "/camera/2/depth", PLAN_TOPIC, "/other"]);
    let whole = {
        let mut whole = Bundle::at(7);
        whole.push_plan(record(1));
        whole
    };
    assert!(whole.offered().is_empty() && whole.messages.len() == 3);
    assert_eq!(some.messages, [whole.messages[0].clone()]);
    assert_eq!(some.messages[0].topic, depth);
}

const NOW_MS: u64 = 1_800_000_000_000;
const BUDGET: u64 = LEAST_BUDGET_BYTES;

fn all(path: &Path) -> Recording {
    let mut all = Recording { ended: true, ..Default::default() };
    for file in files(path).unwrap() {
        let Recording { plans, outcomes, ended } = read_file(&file).unwrap();
        all.plans.extend(plans);
        all.outcomes.extend(outcomes);
        all.ended &= ended;
    }
    all
}

#[test]
fn what_is_written_comes_back_pixels_included() {
    let scratch = Scratch::new();
    let (mut folder, opened) = Folder::open(&scratch.0, BUDGET).unwrap();
    assert_eq!(opened, Opened::default());
    for n in 1..=3 {
        folder.write(NOW_MS, &bundle(n)).unwrap();
    }
    let mut report = Bundle::at(5);
    report.push_outcome(&outcome(2));
    folder.write(NOW_MS, &report).unwrap();
    // Before its end too.
    let Recording { plans, outcomes, ended } = all(&scratch.0);
    assert_eq!((plans.len(), outcomes.len(), ended), (3, 1, false));
    drop(folder);
    let Recording { plans, outcomes, ended } = all(&scratch.0);
    assert!(ended);
    assert_eq!(plans, [record(1), record(2), record(3)]);
    assert_eq!(outcomes, [outcome(2)]);
}

#[test]
fn pixels_are_in_a_file_once() {
    let scratch = Scratch::new();
    let (mut folder, _) = Folder::open(&scratch.0, BUDGET).unwrap();
    folder.write(NOW_MS, &bundle(7)).unwrap();
    drop(folder);
    let bytes = fs::read(&files(&scratch.0).unwrap()[0]).unwrap();
    let Some(Request::PlanGrasps(plan)) = record(7).request else { panic!("no request") };
    for frame in plan.frames {
        assert_eq!(bytes.windows(frame.data.len()).filter(|w| *w == &frame.data[..]).count(), 1);
    }
}

#[test]
fn a_file_cut_anywhere_gives_whole_calls_and_is_repaired() {
    let scratch = Scratch::new();
    let (mut folder, _) = Folder::open(&scratch.0, BUDGET).unwrap();
    let mut lengths = Vec::new();
    for n in 1..=4 {
        folder.write(NOW_MS, &bundle(n)).unwrap();
        lengths.push(fs::metadata(&files(&scratch.0).unwrap()[0]).unwrap().len());
    }
    let path = files(&scratch.0).unwrap().remove(0);
    // As it is while the process lives, which is how a killed one leaves it.
    let bytes = fs::read(&path).unwrap();
    drop(folder);
    let begin = usize::try_from(lengths[0]).unwrap() - 2000;
    for cut in (begin..bytes.len()).step_by(97) {
        let whole = lengths.iter().filter(|length| **length <= cut as u64).count();
        let read = read_bytes(&bytes[..cut]).unwrap();
        // A chunk is whole a little before the indexes that come after it.
        assert!([whole, whole + 1].contains(&read.plans.len()), "cut at {cut} of {}", bytes.len());
        assert!(!read.ended);
        for (n, plan) in (1..).zip(&read.plans) {
            assert_eq!(*plan, record(n));
        }
    }
    fs::write(&path, &bytes[..bytes.len() - 2000]).unwrap();
    let (folder, opened) = Folder::open(&scratch.0, BUDGET).unwrap();
    assert_eq!(opened, Opened { files: 1, repaired: 1 });
    assert_eq!(
        all(&scratch.0),
        Recording { plans: vec![record(1), record(2), record(3)], outcomes: vec![], ended: true }
    );
    drop(folder);
    // What is no recording stays as it is.
    fs::write(&path, b"something else").unwrap();
    let (_folder, opened) = Folder::open(&scratch.0, BUDGET).unwrap();
    assert_eq!(opened, Opened { files: 1, repaired: 0 });
    assert_eq!(fs::read(&path).unwrap(), b"something else");
}

#[test]
fn damage_before_the_end_is_an_error() {
    let scratch = Scratch::new();
    let (mut folder, _) = Folder::open(&scratch.0, BUDGET).unwrap();
    folder.write(NOW_MS, &bundle(3)).unwrap();
    drop(folder);
    let mut bytes = fs::read(&files(&scratch.0).unwrap()[0]).unwrap();
    let Some(Request::PlanGrasps(plan)) = record(3).request else { panic!("no request") };
    let pixels = &plan.frames[0].data;
    let at = bytes.windows(pixels.len()).position(|w| w == &pixels[..]).unwrap();
    bytes[at + 100] ^= 1;
    assert!(matches!(read_bytes(&bytes), Err(ReadError::Mcap { .. })));
    assert!(matches!(read_bytes(b"PNG"), Err(ReadError::Mcap { .. })));
}

#[test]
fn the_oldest_files_go_first_and_the_budget_holds() {
    let scratch = Scratch::new();
    let (mut folder, _) = Folder::open(&scratch.0, BUDGET).unwrap();
    let size =
        |path: &Path| -> u64 { files(path).unwrap().iter().map(|f| fs::metadata(f).unwrap().len()).sum() };
    let mut large = record(0);
    let Some(Request::PlanGrasps(plan)) = &mut large.request else { panic!("no request") };
    plan.frames[0].data = vec![7; 700_000].into();
    for n in 0..60u64 {
        let mut bundle = Bundle::at(n);
        let mut record = large.clone();
        record.trace_id = n.to_string();
        bundle.push_plan(record);
        folder.write(NOW_MS + n, &bundle).unwrap();
        assert!(size(&scratch.0) <= BUDGET, "{} bytes after {n}", size(&scratch.0));
        assert!(folder.used_bytes() <= BUDGET);
    }
    drop(folder);
    assert!(size(&scratch.0) <= BUDGET && size(&scratch.0) > BUDGET / 2);
    let kept: Vec<u64> = all(&scratch.0).plans.iter().map(|p| p.trace_id.parse().unwrap()).collect();
    assert!(kept.len() > 10 && kept[0] > 30, "{kept:?}");
    assert!(kept.windows(2).all(|pair| pair[0] + 1 == pair[1]), "{kept:?}");
    assert_eq!(kept.last(), Some(&59));
    // A smaller rest of an earlier run counts too.
    let (mut folder, opened) = Folder::open(&scratch.0, BUDGET).unwrap();
    assert!(opened.files > 1 && opened.repaired == 0);
    let mut huge = Bundle::at(0);
    plan_of(&mut large).frames[0].data = vec![1; 17 << 20].into();
    huge.push_plan(large);
    assert!(matches!(folder.write(NOW_MS, &huge), Err(FolderError::TooLarge { .. })));
    folder.write(NOW_MS, &bundle(1)).unwrap();
}

fn plan_of(record: &mut v1::PlanRecord) -> &mut v1::PlanGraspsRequest {
    match &mut record.request {
        Some(Request::PlanGrasps(plan)) => plan,
        other => panic!("{other:?}"),
    }
}

#[test]
fn a_folder_has_one_writer() {
    let scratch = Scratch::new();
    let (first, _) = Folder::open(&scratch.0, BUDGET).unwrap();
    assert!(matches!(Folder::open(&scratch.0, BUDGET), Err(FolderError::InUse { .. })));
    drop(first);
    assert!(Folder::open(&scratch.0, BUDGET).is_ok());
    assert!(matches!(Folder::open(&scratch.0, 1000), Err(FolderError::Budget { found: 1000 })));
}

#[test]
fn a_plan_is_found_by_its_name() {
    let scratch = Scratch::new();
    let (mut folder, _) = Folder::open(&scratch.0, BUDGET).unwrap();
    for n in 1..=9 {
        // Written a while after the plan got its name, in a file of its own.
        folder.write(NOW_MS + u64::from(n), &bundle(n)).unwrap();
        folder.end_file().unwrap();
    }
    folder.write(NOW_MS + 20, &bundle(20)).unwrap();
    let expected =
        FoundPlan { hand: "hands/leap".to_owned(), scores: vec![(0.5, 0.75)], calibration: String::new() };
    for n in (1..=9).chain([20]) {
        assert_eq!(find_plan(&scratch.0, id(n)).unwrap(), Some(expected.clone()), "{n}");
    }
    assert_eq!(find_plan(&scratch.0, id(10)).unwrap(), None);
    assert_eq!(find_plan(&scratch.0, PlanId::new(0, [0; 10])).unwrap(), None);
    assert_eq!(find_plan(&scratch.0, PlanId::new((1 << 48) - 1, [0; 10])).unwrap(), None);
}
