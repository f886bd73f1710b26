//! The failed trials whose pictures are in `docs/simulation.md` can be read and executed by this program.

use std::path::Path;

use graspd_hands::library;
use graspd_training::evaluate::{Class, FailedTrial};

#[test]
fn every_pictured_failure_is_a_trial_of_its_class() {
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
        let actuators = library::hand(&trial.attempt.hand).unwrap().actuation.actuator_count();
        assert_eq!(trial.command.as_ref().unwrap().squeezed.len(), actuators, "{name}");
        assert_eq!(trial.world().unwrap().ids().len(), trial.attempt.objects, "{name}");
        assert!(folder.join(name).with_extension("png").exists(), "{name}");
    }
}
