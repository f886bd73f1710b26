//! The loop with scripted devices: what it does when nothing goes wrong, and what is kept of it.
#![allow(clippy::unwrap_used, reason = "helpers of tests are not in test functions")]

mod scripted;

use graspd_cell::config::CellConfig;
use graspd_cell::outcome::{End, FailureClass, Holding, Outcome};
use graspd_cell::plan::ReachingChoice;
use graspd_cell::record::{read_attempts, read_run, replay};
use graspd_cell::report::Report;
use graspd_cell::steps::Step;
use graspd_cell::witness::{Witness, Witnessed};
use graspd_cell::{CellError, clear_tray};
use scripted::{Fault, Shared, Watcher, config, run};
use std::path::PathBuf;
use std::time::Duration;

/// A folder that goes with the test.
struct Folder(PathBuf);

impl Folder {
    fn new(name: &str) -> Self {
        let path = std::env::temp_dir().join(format!("graspd-cell-{name}-{}", std::process::id()));
        let _ = std::fs::remove_dir_all(&path);
        Self(path)
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

#[tokio::test(start_paused = true)]
async fn five_objects_are_cleared() {
    let shared = Shared::new(5);
    let (report, log) = run(&shared, &config()).await;
    assert_eq!(report.end, End::Empty);
    assert_eq!((report.tally.trials, report.tally.successes, report.tally.not_executed), (5, 5, 2));
    assert_eq!((report.tally.rate(), report.holding), (Some(1.0), Holding::Nothing));
    assert_eq!((shared.world().delivered, log), (5, vec![]));
    // Every plan has its own seed.
    let seeds: Vec<u64> = shared.world().questions.iter().map(|q| q.seed).collect();
    assert_eq!(seeds, (0..7).collect::<Vec<u64>>());
    let table = report.to_string();
    assert!(table.contains("success rate    100.0 % (5 of n = 5 grasp trials)"), "{table}");
}

#[tokio::test(start_paused = true)]
async fn a_run_is_recorded_and_every_attempt_can_be_planned_again() {
    let folder = Folder::new("record");
    let shared = Shared::new(2).with_fault(Step::Approach, Fault::Stop, 1);
    let mut config = config();
    config.recording.folder = Some(folder.0.clone());
    let (report, _) = run(&shared, &config).await;
    assert_eq!((report.tally.trials, report.tally.successes, &report.record_trouble), (3, 2, &None));
    let info = read_run(&folder.0).unwrap();
    assert_eq!((info.config, info.hand_revision.as_str()), (config.clone(), "r1"));
    let attempts = read_attempts(&folder.0).unwrap().records;
    assert_eq!(attempts.len() as u32, report.tally.attempts);
    assert!(matches!(&attempts[0].outcome, Outcome::Failed { .. }) && attempts[0].trial);
    assert_eq!(attempts[1].outcome, Outcome::Success);
    // The grasp that failed is not tried first again.
    assert_eq!(attempts[0].chosen.as_ref().unwrap().rank, 0);
    assert_eq!(attempts[1].chosen.as_ref().unwrap().rank, 1);
    assert!(
        attempts[1]
            .steps
            .iter()
            .map(|s| s.step)
            .eq(Step::ALL.into_iter().filter(|s| !matches!(s, Step::Retreat | Step::Follow)))
    );
    {
        // The planner answers as it did while the objects were there.
        let mut world = shared.world();
        world.in_tray = 2;
        world.delivered = 0;
    }
    for attempt in &attempts[..2] {
        let again = replay(&shared, &folder.0, attempt.attempt, Duration::from_secs(5)).await.unwrap();
        assert!(again.same && !again.hand_changed && again.apart == Some((0.0, 0.0)), "{again:?}");
    }
    let missing = replay(&shared, &folder.0, 99, Duration::from_secs(5)).await.unwrap_err().to_string();
    assert_eq!(missing, "attempt: found 99, expected 1 to 5");
    // A line that was cut off by the end of its program is left out, and told; one that is wrong is not.
    let (lines, text) =
        (folder.0.join("attempts.jsonl"), std::fs::read_to_string(folder.0.join("attempts.jsonl")).unwrap());
    std::fs::write(&lines, &text[..text.len() - 40]).unwrap();
    let cut = read_attempts(&folder.0).unwrap();
    assert_eq!((cut.cut_line, &cut.records[..]), (Some(attempts.len()), &attempts[..attempts.len() - 1]));
    std::fs::write(&lines, format!("{}\n", &text[..text.len() - 40])).unwrap();
    let wrong = read_attempts(&folder.0).unwrap_err().to_string();
    assert!(wrong.contains(&format!("line {}: ", attempts.len())), "{wrong}");
    // A folder is never written over.
    let mut watcher = Watcher { shared: shared.clone(), log: Vec::new() };
    let error = clear_tray(&shared.cell(), &config, &mut watcher).await.unwrap_err();
    assert!(matches!(error, CellError::Record(_)), "{error}");
}

#[tokio::test(start_paused = true)]
async fn a_record_that_cannot_be_written_does_not_stop_the_arm() {
    let folder = Folder::new("full");
    let shared = Shared::new(2);
    let mut config = config();
    config.recording.folder = Some(folder.0.clone());
    let (cell, path) = (shared.cell(), folder.0.clone());
    let mut watcher = Watcher { shared: shared.clone(), log: Vec::new() };
    let clearing = clear_tray(&cell, &config, &mut watcher);
    let breaking = async {
        tokio::time::sleep(Duration::from_millis(300)).await;
        std::fs::remove_dir_all(path.join("frames")).unwrap();
    };
    let (report, ()) = tokio::join!(clearing, breaking);
    let report = report.unwrap();
    assert_eq!((report.end, report.tally.successes), (End::Empty, 2));
    assert!(report.record_trouble.unwrap().contains("frames"));
}

#[tokio::test(start_paused = true)]
async fn a_hand_that_is_not_the_planned_one_is_refused_before_anything_moves() {
    let shared = Shared::new(1);
    let mut cell = shared.cell();
    cell.hand = std::sync::Arc::new(OtherHand(shared.clone()));
    let mut watcher = Watcher { shared: shared.clone(), log: Vec::new() };
    let error = clear_tray(&cell, &config(), &mut watcher).await.unwrap_err().to_string();
    assert_eq!(
        error,
        "actuators of other: found [\"jaw\"], expected [\"finger\", \"thumb\"], those of hand robotiq-2f85"
    );
    assert!(!shared.world().calls.contains_key("move_to"));
}

#[tokio::test(start_paused = true)]
async fn a_wrong_configuration_is_refused() {
    let shared = Shared::new(1);
    let mut watcher = Watcher { shared: shared.clone(), log: Vec::new() };
    let mut wrong = CellConfig::default();
    wrong.run.trials = 0;
    let error = clear_tray(&shared.cell(), &wrong, &mut watcher).await.unwrap_err().to_string();
    assert_eq!(error, "run.trials: found 0, expected 1 to 1000000");
}

#[tokio::test(start_paused = true)]
async fn trials_time_and_a_request_end_the_run_between_attempts() {
    let mut few = config();
    few.run.trials = 3;
    let shared = Shared::new(5);
    let (report, _) = run(&shared, &few).await;
    assert_eq!((report.end, shared.world().delivered), (End::Trials, 3));
    let mut short = config();
    short.run.time_limit_s = 30.0;
    let shared = Shared::new(50);
    let (report, _) = run(&shared, &short).await;
    assert_eq!((report.end.clone(), report.holding), (End::TimeLimit, Holding::Nothing));
    assert!(report.tally.trials > 0 && report.duration_s < 60.0, "{report:?}");
    let shared = Shared::new(5);
    let (cell, config) = (shared.cell(), config());
    let mut watcher = Watcher { shared: shared.clone(), log: Vec::new() };
    let ask = async {
        tokio::time::sleep(Duration::from_secs(8)).await;
        shared.world().end_wanted = true;
    };
    let (report, ()) = tokio::join!(clear_tray(&cell, &config, &mut watcher), ask);
    let report = report.unwrap();
    assert_eq!((report.end.clone(), report.holding), (End::Asked, Holding::Nothing));
    assert_eq!(report.tally.successes, shared.world().delivered);
}

#[tokio::test(start_paused = true)]
async fn no_grasp_is_asked_again_otherwise_and_then_given_up_with_reasons() {
    let shared = Shared::new(1).with_fault(Step::Plan, Fault::NoGrasp, 3);
    let (report, log) = run(&shared, &config()).await;
    assert_eq!((report.end, report.tally.successes, report.tally.not_executed), (End::Empty, 1, 5));
    assert_eq!(log, vec!["plan no grasp PlanAgain"; 3]);
    let questions = shared.world().questions.clone();
    let reaching: Vec<_> = questions.iter().take(4).map(|q| q.reaching).collect();
    let (down, free) = (ReachingChoice::TopDown, ReachingChoice::Free);
    assert_eq!(reaching, [down, free, down, free]);
    let shared = Shared::new(1).with_fault(Step::Plan, Fault::NoGrasp, u32::MAX);
    let (report, _) = run(&shared, &config()).await;
    let End::NoGrasp { why } = &report.end else { panic!("{report:?}") };
    assert_eq!(why, "all_rejected: scripted (collision_table 31, no_contact 9)");
    assert_eq!(report.tally.not_executed, 12);
}

/// A hand with another actuator.
#[derive(Debug)]
struct OtherHand(Shared);

#[graspd_adapters_core::async_trait]
impl graspd_adapters_core::Hand for OtherHand {
    fn info(&self) -> graspd_adapters_core::HandInfo {
        let mut info = graspd_adapters_core::Hand::info(&self.0);
        (info.name, info.actuators) = ("other".into(), vec!["jaw".into()]);
        info
    }

    async fn state(
        &self,
        timeout: Duration,
    ) -> Result<graspd_adapters_core::HandState, graspd_adapters_core::DeviceError> {
        graspd_adapters_core::Hand::state(&self.0, timeout).await
    }

    async fn grip(
        &self,
        command: &graspd_adapters_core::GripCommand,
        timeout: Duration,
    ) -> Result<graspd_adapters_core::HandState, graspd_adapters_core::DeviceError> {
        graspd_adapters_core::Hand::grip(&self.0, command, timeout).await
    }

    async fn clear_fault(&self, timeout: Duration) -> Result<(), graspd_adapters_core::DeviceError> {
        graspd_adapters_core::Hand::clear_fault(&self.0, timeout).await
    }
}

/// A hand that closes by itself, and what it was told.
#[derive(Debug)]
struct ClosingHand {
    shared: Shared,
    told: std::sync::Mutex<Vec<graspd_adapters_core::CloseCommand>>,
}

#[graspd_adapters_core::async_trait]
impl graspd_adapters_core::Hand for ClosingHand {
    fn info(&self) -> graspd_adapters_core::HandInfo {
        graspd_adapters_core::Hand::info(&self.shared)
    }

    async fn state(
        &self,
        timeout: Duration,
    ) -> Result<graspd_adapters_core::HandState, graspd_adapters_core::DeviceError> {
        graspd_adapters_core::Hand::state(&self.shared, timeout).await
    }

    async fn grip(
        &self,
        command: &graspd_adapters_core::GripCommand,
        timeout: Duration,
    ) -> Result<graspd_adapters_core::HandState, graspd_adapters_core::DeviceError> {
        // What is gripped by itself is the open posture.
        assert_eq!(command.actuators, [0.0, 0.0]);
        graspd_adapters_core::Hand::grip(&self.shared, command, timeout).await
    }

    async fn close(
        &self,
        command: &graspd_adapters_core::CloseCommand,
        timeout: Duration,
    ) -> Result<graspd_adapters_core::HandState, graspd_adapters_core::DeviceError> {
        self.told.lock().unwrap().push(command.clone());
        graspd_adapters_core::Hand::close(&self.shared, command, timeout).await
    }

    async fn clear_fault(&self, timeout: Duration) -> Result<(), graspd_adapters_core::DeviceError> {
        graspd_adapters_core::Hand::clear_fault(&self.shared, timeout).await
    }
}

#[tokio::test(start_paused = true)]
async fn a_hand_is_told_where_contact_is_expected_in_its_own_order() {
    let shared = Shared::new(2);
    let hand = std::sync::Arc::new(ClosingHand { shared: shared.clone(), told: std::sync::Mutex::default() });
    let cell = graspd_cell::Cell { hand: hand.clone(), ..shared.cell() };
    let mut config = config();
    (config.hand.meet_s, config.hand.force) = (0.8, 0.6);
    let mut watcher = Watcher { shared: shared.clone(), log: Vec::new() };
    let report = clear_tray(&cell, &config, &mut watcher).await.unwrap();
    assert_eq!((report.end, report.tally.successes), (End::Empty, 2));
    let told = hand.told.lock().unwrap();
    let expected = graspd_adapters_core::CloseCommand {
        contact: vec![0.6, 1.2],
        // Each finger has one motor: they close as far as they are let.
        squeezed: vec![1.0, 2.0],
        farthest: vec![1.0, 2.0],
        meet: Duration::from_millis(800),
        speed: config.hand.speed,
        force: 0.6,
    };
    assert_eq!(*told, [expected.clone(), expected]);
}

#[tokio::test(start_paused = true)]
async fn the_hand_opens_as_the_grasp_asks_among_objects_and_wide_at_the_drop_pose() {
    let shared = Shared::new(1).with_fault(Step::Approach, Fault::Stop, 1);
    shared.world().open = 0.3;
    let (report, log) = run(&shared, &config()).await;
    assert_eq!((report.end, report.tally.successes), (End::Empty, 1), "{log:?}");
    let told = |step| {
        let world = shared.world();
        world.thumb.iter().filter(|(s, _)| *s == step).map(|(_, at)| *at).collect::<Vec<f64>>()
    };
    assert_eq!((told(Step::ClearView), told(Step::Open)), (vec![0.0], vec![0.3, 0.3]));
    assert_eq!((told(Step::Retreat), told(Step::Release)), (vec![0.3], vec![0.0]));
}

#[tokio::test(start_paused = true)]
async fn the_planner_is_told_where_the_walls_are() {
    let shared = Shared::new(1);
    let config = config();
    run(&shared, &config).await;
    let walls = config.tray.walls();
    assert_eq!(walls.len(), 4);
    assert!(shared.world().questions.iter().all(|q| q.keep_out == walls));
}

/// Sees everything in the scripted world, or nothing.
#[derive(Debug)]
struct Truth {
    shared: Shared,
    blind: bool,
    delivered: std::sync::Mutex<u32>,
}

#[graspd_adapters_core::async_trait]
impl Witness for Truth {
    async fn outcome(&self, _attempt: u32) -> Option<Witnessed> {
        let world = self.shared.world();
        let before = std::mem::replace(&mut *self.delivered.lock().unwrap(), world.delivered);
        (!self.blind).then(|| Witnessed {
            delivered: world.delivered - before,
            lost: world.lost,
            in_tray: world.in_tray,
            in_hand: world.in_hand,
            remaining: Vec::new(),
        })
    }
}

/// A run with a witness.
async fn witnessed(shared: &Shared, blind: bool) -> Report {
    let truth = Truth { shared: shared.clone(), blind, delivered: std::sync::Mutex::default() };
    let cell = graspd_cell::Cell { witness: Some(std::sync::Arc::new(truth)), ..shared.cell() };
    let mut watcher = Watcher { shared: shared.clone(), log: Vec::new() };
    let report = clear_tray(&cell, &config(), &mut watcher).await.unwrap();
    let t = &report.tally;
    let sum = t.delivered.zip(t.lost).zip(t.in_tray).zip(t.in_hand).map(|(((d, l), i), h)| d + l + i + h);
    assert_eq!(sum, (!blind).then(|| shared.world().total), "{t:?}");
    report
}

#[tokio::test(start_paused = true)]
async fn a_witness_decides_what_is_a_success() {
    // Felt to the end, and fallen beside the place.
    let shared = Shared::new(2);
    shared.world().misses = 1;
    let report = witnessed(&shared, false).await;
    let t = &report.tally;
    assert_eq!((t.trials, t.successes, t.felt, t.delivered, t.lost), (2, 1, 2, Some(1), Some(1)));
    assert_eq!(t.failures.get(&FailureClass::NotDelivered), Some(&1));
    assert!(report.to_string().contains("1 delivered, 1 lost, 0 left in the tray"), "{report}");
    // Not felt at the drop pose, and arrived.
    let shared = Shared::new(1).with_fault(Step::CheckDelivered, Fault::Numb, 1);
    let t = witnessed(&shared, false).await.tally;
    assert_eq!((t.trials, t.successes, t.felt, t.delivered), (1, 1, 0, Some(1)), "{t:?}");
    assert_eq!(t.failures.len(), 0);
    // What lies in the tray when the run ends.
    let shared = Shared::new(3).with_fault(Step::CheckContact, Fault::Slips, u32::MAX);
    let t = witnessed(&shared, false).await.tally;
    assert_eq!((t.successes, t.delivered, t.in_tray), (0, Some(0), Some(3)));
}

#[tokio::test(start_paused = true)]
async fn a_witness_that_cannot_tell_changes_nothing() {
    let shared = Shared::new(2);
    shared.world().misses = 1;
    let t = witnessed(&shared, true).await.tally;
    assert_eq!((t.trials, t.successes, t.felt, t.delivered, t.lost), (2, 2, 2, None, None));
}

#[tokio::test(start_paused = true)]
async fn grasps_that_the_arm_cannot_reach_are_left_out_before_anything_moves() {
    let folder = Folder::new("reach");
    let shared = Shared::new(1);
    // Grasps lie at x = 0, 0.05 and -0.05, best first.
    shared.world().reach_x_m = Some(-0.01);
    let mut config = config();
    config.recording.folder = Some(folder.0.clone());
    let (report, log) = run(&shared, &config).await;
    assert_eq!((report.end.clone(), report.tally.trials, report.tally.successes), (End::Empty, 1, 1));
    assert_eq!((report.tally.out_of_reach, log), (2, vec![]), "nothing is refused on the way");
    let near = |x: f64| shared.world().moves.iter().any(|(_, at)| (at.translation.vector.x - x).abs() < 1e-6);
    assert!(near(-0.05) && !near(0.0) && !near(0.05));
    let attempts = read_attempts(&folder.0).unwrap().records;
    let ranks: Vec<usize> = attempts[0].out_of_reach.iter().map(|out| out.rank).collect();
    assert_eq!((ranks, attempts[0].chosen.as_ref().unwrap().rank), (vec![0, 1], 2));
    assert_eq!(attempts[0].out_of_reach[0].to, "grasp");
    let table = report.to_string();
    assert!(table.contains("out of reach    2 grasps, left out before anything moved"), "{table}");
    assert!(table.contains("to its grasp: arm: x: found far, expected near"), "{table}");
}

#[tokio::test(start_paused = true)]
async fn a_tray_beyond_reach_ends_the_run_and_says_so() {
    let shared = Shared::new(2);
    shared.world().reach_x_m = Some(-1.0);
    let (report, _) = run(&shared, &config()).await;
    let End::NoGrasp { why } = &report.end else { panic!("{:?}", report.end) };
    assert!(
        why.starts_with("none of 3 grasps is in reach; the best, to its grasp: arm: x: found far"),
        "{why}"
    );
    assert_eq!((report.tally.trials, shared.world().in_tray), (0, 2));
    // The hand has not come near the tray.
    assert!(shared.world().moves.iter().all(|(_, at)| at.translation.vector.x > 0.2));
}
