//! A small clearing run, end to end: its counts add up, it repeats itself, and its failed trials repeat
//! themselves.

use std::sync::{Arc, Mutex};

use graspd_hands::library;
use graspd_planner::estimator::Geometric;
use graspd_planner::options::{PlanOptions, Scheme, VolumeKind};
use graspd_sim::execute::ExecuteSettings;
use graspd_sim::object::Object;
use nalgebra::Vector3;

use super::{
    Attempt, Class, ClearSettings, FailedTrial, Observer, Report, Run, Setup, Station, clear, replay,
};

/// Keeps what fails.
#[derive(Default)]
struct Keeper(Mutex<Vec<FailedTrial>>);

impl Observer for Keeper {
    fn attempt(&self, _: &Attempt) {}
    fn failed(&self, trial: &FailedTrial) {
        self.0.lock().unwrap().push(trial.clone());
    }
    fn run(&self, _: &Run) {}
}

/// A box that any jaw takes, and one that is far wider than the jaw opens.
fn settings(workers: usize) -> ClearSettings {
    let object = |name: &str, half: Vector3<f64>| Arc::new(Object::cuboid(name, half).unwrap());
    ClearSettings {
        hands: vec![Arc::new(library::hand("robotiq-2f85").unwrap().clone())],
        objects: vec![
            object("box", Vector3::new(0.02, 0.03, 0.025)),
            object("block", Vector3::new(0.07, 0.075, 0.08)),
        ],
        per_tray: 2,
        setups: vec![Setup::Single],
        give_up: 2,
        seed: 5,
        volume: VolumeKind::Tsdf,
        search: PlanOptions { batch: 16, scheme: Scheme::QUICK, ..PlanOptions::default() },
        execute: ExecuteSettings::default(),
        workers,
    }
}

/// Without the times, which differ.
fn untimed(mut runs: Vec<Run>) -> Vec<Run> {
    runs.iter_mut().for_each(|r| r.planning_ms.clear());
    runs
}

#[test]
fn a_small_run_repeats_itself_and_its_counts_add_up() {
    let (station, estimator) = (Station::tray(), Geometric);
    let keeper = Keeper::default();
    let runs = clear(&settings(2), &station, &estimator, &keeper).unwrap();
    assert!(runs.iter().all(|r| r.planning_ms.len() == r.attempts.len()));
    let again = clear(&settings(1), &station, &estimator, &Keeper::default()).unwrap();
    let runs = untimed(runs);
    assert_eq!(runs, untimed(again));

    // What fits is cleared; what does not is given up, and every failure was kept.
    let failed = keeper.0.into_inner().unwrap();
    assert_eq!(runs.len(), 2);
    assert!(runs[0].items[0].cleared, "{:?}", runs[0]);
    assert!(!runs[1].items[0].cleared, "{:?}", runs[1]);
    let attempts: Vec<&Attempt> = runs.iter().flat_map(|r| &r.attempts).collect();
    assert_eq!(failed.len(), attempts.iter().filter(|a| a.class != Class::Success).count());
    assert!(!failed.is_empty());

    // The report counts the same.
    let report = Report::new(vec!["condition".into()], runs.clone());
    assert_eq!(report.cells.len(), 1);
    let cell = &report.cells[0];
    assert_eq!((cell.items, cell.cleared), (2, 1));
    assert_eq!(cell.trials + cell.empty_plans, attempts.len());
    assert_eq!(cell.classes.values().sum::<usize>(), attempts.len());
    assert_eq!(cell.successes + failed.len(), attempts.len());
    assert!(report.text().contains("condition") && report.markdown().contains("| Single"));
    let json = serde_json::to_string(&report).unwrap();
    assert_eq!(serde_json::from_str::<Report>(&json).unwrap(), report);

    // A failed trial ends as it ended, also after its file was written and read.
    let hand = &settings(1).hands[0];
    for trial in &failed {
        let trial = FailedTrial::from_json(&trial.to_json().unwrap()).unwrap();
        let replay = replay(&trial, hand, &estimator, &mut |_, _| {}).unwrap();
        assert!(replay.same, "{}: now {:?}", trial.name(), replay.class);
    }
}

#[test]
fn settings_of_no_use_are_named() {
    let nothing = ClearSettings { objects: Vec::new(), ..settings(1) };
    let error = clear(&nothing, &Station::tray(), &Geometric, &Keeper::default());
    assert!(error.unwrap_err().to_string().starts_with("objects: found 0"));
}
