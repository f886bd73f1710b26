//! The failed trials whose pictures are in `docs/simulation.md` are executed by this program, and end as pictured.

use std::path::Path;
use std::sync::Arc;

use graspd_hands::library;
use graspd_planner::estimator::Geometric;
use graspd_training::evaluate::{Class, FailedTrial, replay};

#[test]
fn every_pictured_failure_ends_in_its_class_when_it_is_executed() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../docs/images/failures");
    for (name, class) in [
        ("collision_table", Class::CollisionTable),
        ("collision_object", Class::CollisionObject),
        ("lost_closing", Class::LostClosing),
        ("unstable_contact", Class::UnstableContact),
        ("lost_lifting", Class::LostLifting),
    ] {
        let text = std::fs::read_to_string(folder.join(name).with_extension("json")).unwrap();
        let trial = FailedTrial::from_json(&text).unwrap();
        assert_eq!(trial.attempt.class, class, "{name}");
        let hand = Arc::new(library::hand(&trial.attempt.hand).unwrap().clone());
        let actuators = hand.actuation.actuator_count();
        assert_eq!(trial.command.as_ref().unwrap().squeezed.len(), actuators, "{name}");
        assert_eq!(trial.world().unwrap().ids().len(), trial.attempt.objects, "{name}");
        assert!(folder.join(name).with_extension("png").exists(), "{name}");
        let mut moments = 0;
        let again = replay(&trial, &hand, &Geometric, &mut |_, _| moments += 1).unwrap();
        assert_eq!((again.class, moments), (class, 3), "{name}");
        assert!(again.same, "{name}");
    }
}
