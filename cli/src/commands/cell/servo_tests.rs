//! A hand with a camera in its palm follows its grasps in a simulated world, over the network, until the tray is empty.

use std::sync::Arc;

use graspd_cell::config::CellConfig;
use graspd_cell::observer::{Event, Observer};
use graspd_cell::outcome::End;
use graspd_cell::record::AttemptRecord;
use graspd_cell::report::Report;
use graspd_cell::steps::Step;
use graspd_cell::{Cell, clear_tray};

use super::{with_planner, world};

/// Keeps every attempt.
#[derive(Default)]
struct Keeper(Vec<AttemptRecord>);

impl Observer for Keeper {
    fn on(&mut self, event: &Event<'_>) {
        if let Event::AttemptEnded { record, .. } = event {
            self.0.push((*record).clone());
        }
    }
}

/// An example with fewer objects, and its run.
async fn run(example: &str, objects: i64) -> (Report, Vec<AttemptRecord>) {
    let mut config = CellConfig::parse(example).unwrap();
    world::place_palm_camera(&mut config).unwrap();
    config.check().unwrap();
    config.simulation.as_mut().unwrap().insert("objects".to_owned(), objects.into());
    let world::Devices { camera, arm, hand, witness, trouble: _trouble, .. } =
        world::devices(&config).await.unwrap();
    let mut keeper = Keeper::default();
    let report = with_planner(&config, async |planner| {
        let cell = Cell { camera, arm, hand, planner: Arc::new(planner), witness };
        Ok(clear_tray(&cell, &config, &mut keeper).await?)
    });
    (report.await.unwrap(), keeper.0)
}

#[tokio::test(flavor = "multi_thread")]
async fn the_example_clears_a_tray_and_follows_every_grasp() {
    let (report, attempts) = run(include_str!("../../../../examples/servo.toml"), 2).await;
    let t = &report.tally;
    assert_eq!(report.end, End::Empty, "{report}");
    let sum = t.delivered.unwrap() + t.lost.unwrap() + t.in_tray.unwrap() + t.in_hand.unwrap();
    assert_eq!((sum, t.in_tray), (2, Some(0)), "{t:?}");
    assert!(t.successes >= 1, "{t:?}");
    for attempt in attempts.iter().filter(|a| a.trial) {
        assert!(attempt.steps.iter().any(|s| s.step == Step::Follow && s.done), "{attempt:?}");
        let servo = attempt.servo.as_ref().unwrap();
        // From 0.15 to 0.05 m at 0.06 m/s with 15 frames a second: at least 25.
        assert!(servo.answers >= 25 && servo.tracking > servo.answers / 2, "{servo:?}");
        assert!((servo.standoff_m - 0.05).abs() < 1e-9, "{servo:?}");
    }
}

#[test]
fn the_emulated_example_is_the_same_cell() {
    let (mut mock, mut wired) = (
        CellConfig::parse(include_str!("../../../../examples/servo.toml")).unwrap(),
        CellConfig::parse(include_str!("../../../../examples/servo_emulated.toml")).unwrap(),
    );
    for config in [&mut mock, &mut wired] {
        world::place_palm_camera(config).unwrap();
        config.check().unwrap();
    }
    let place = |c: &CellConfig| c.servo.as_ref().unwrap().hand_from_camera;
    assert_eq!(place(&mock), place(&wired));
    assert_eq!((&mock.hand.id, &mock.planner, &mock.tray), (&wired.hand.id, &wired.planner, &wired.tray));
    // A real camera's place must be told.
    "pico-flexx".clone_into(&mut wired.camera.kind);
    wired.servo.as_mut().unwrap().hand_from_camera = None;
    let refused = world::place_palm_camera(&mut wired).unwrap_err().to_string();
    assert!(refused.starts_with("servo.hand_from_camera: missing"), "{refused}");
}
