//! What became of the objects of a simulated tray: a witness that physics tells the truth.

use std::collections::BTreeSet;
use std::sync::{Mutex, PoisonError};

use graspd_adapters_mock::{Census, SharedWorld, WorldEnded};
use graspd_cell::witness::{Witness, Witnessed};
use graspd_sim::world::ObjectId;

/// Simulated seconds for dropped things to fall and roll before they are counted.
const REST_S: f64 = 0.8;

/// Tells by physics what became of the objects.
#[derive(Debug)]
pub(super) struct SimulatedTruth {
    shared: SharedWorld,
    known: Mutex<Known>,
}

/// What a witness remembers.
#[derive(Debug)]
struct Known {
    /// Delivered when asked last.
    delivered: BTreeSet<ObjectId>,
    /// Beside the tray since before the run: not lost by it.
    beside: BTreeSet<ObjectId>,
}

impl SimulatedTruth {
    /// A witness of what becomes of the objects from now on.
    pub(super) async fn new(shared: &SharedWorld) -> Result<Self, WorldEnded> {
        let census = shared.census().await?;
        let beside = census.elsewhere.iter().map(|object| object.id).collect();
        let known = Known { delivered: delivered(&census), beside };
        Ok(Self { shared: shared.clone(), known: Mutex::new(known) })
    }
}

fn delivered(census: &Census) -> BTreeSet<ObjectId> {
    census.delivered.iter().map(|object| object.id).collect()
}

#[graspd_adapters_core::async_trait]
impl Witness for SimulatedTruth {
    async fn outcome(&self, _attempt: u32) -> Option<Witnessed> {
        // A world that has ended has nothing to tell; the devices report it.
        self.shared.wait(REST_S).await.ok()?;
        let census = self.shared.census().await.ok()?;
        let mut known = self.known.lock().unwrap_or_else(PoisonError::into_inner);
        let elsewhere: BTreeSet<ObjectId> = census.elsewhere.iter().map(|object| object.id).collect();
        // What the run has moved is its own from then on.
        known.beside.retain(|id| elsewhere.contains(id));
        let arrived = delivered(&census);
        let witnessed = Witnessed {
            delivered: arrived.difference(&known.delivered).count() as u32,
            lost: elsewhere.difference(&known.beside).count() as u32,
            in_tray: census.tray.len() as u32,
            in_hand: census.held.len() as u32,
            remaining: census.tray.iter().map(|object| object.name.clone()).collect(),
        };
        known.delivered = arrived;
        Some(witnessed)
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use graspd_adapters_mock::SharedWorldSettings;
    use graspd_sim::object::Object;
    use graspd_sim::world::{Tray, World, WorldSettings};
    use nalgebra::{Isometry3, Vector3};

    /// What the witness says, and that it adds up to `objects`.
    async fn says(truth: &SimulatedTruth, before: &mut u32, objects: u32) -> Witnessed {
        let seen = truth.outcome(1).await.unwrap();
        *before += seen.delivered;
        assert_eq!(*before + seen.lost + seen.in_tray + seen.in_hand, objects, "{seen:?}");
        seen
    }

    #[tokio::test]
    async fn what_the_witness_counts_adds_up() {
        let mut world = World::new(WorldSettings { tray: Some(Tray::default()), ..WorldSettings::default() });
        let cuboid = |name: &str| Arc::new(Object::cuboid(name, Vector3::new(0.02, 0.02, 0.02)).unwrap());
        let at = |x: f64, y: f64| Isometry3::translation(x, y, 0.02);
        let first = world.add(cuboid("first"), &at(0.0, 0.0));
        let second = world.add(cuboid("second"), &at(0.1, 0.0));
        let beside = world.add(cuboid("beside"), &at(0.0, 0.35));
        let (beyond, bin) = (at(-0.3, 0.0), at(0.40, 0.0));
        let shared = SharedWorld::new(world, SharedWorldSettings::default()).unwrap();
        let truth = SimulatedTruth::new(&shared).await.unwrap();
        let place = |id, to: Isometry3<f64>| shared.with(move |world| assert!(world.place(id, &to)));
        let mut all = 0;
        let seen = says(&truth, &mut all, 2).await;
        assert_eq!(
            (seen.delivered, seen.lost, seen.in_tray),
            (0, 0, 2),
            "the third lay beside the tray before"
        );
        assert_eq!(seen.remaining, ["first", "second"]);
        // One leaves the tray, and stays where it is.
        place(first, beyond).await.unwrap();
        assert_eq!(says(&truth, &mut all, 2).await.lost, 1);
        assert_eq!(says(&truth, &mut all, 2).await.lost, 1, "still lost");
        // It comes back while the other one leaves: one is lost, as before, and it is another one.
        place(first, at(0.0, 0.0)).await.unwrap();
        place(second, beyond).await.unwrap();
        let seen = says(&truth, &mut all, 2).await;
        assert_eq!((seen.lost, &seen.remaining[..]), (1, &["first".to_owned()][..]));
        // What was lost is delivered after all.
        place(second, bin).await.unwrap();
        let seen = says(&truth, &mut all, 2).await;
        assert_eq!((seen.delivered, seen.lost, seen.in_tray), (1, 0, 1));
        assert_eq!(says(&truth, &mut all, 2).await.delivered, 0, "an object arrives once");
        // What lay beside the tray is the run's from when it picks it up.
        place(beside, at(0.1, 0.0)).await.unwrap();
        assert_eq!(says(&truth, &mut all, 3).await.in_tray, 2);
        place(beside, beyond).await.unwrap();
        assert_eq!(says(&truth, &mut all, 3).await.lost, 1);
        // A world that has ended has nothing to tell.
        let broken = shared.with::<()>(|_| std::panic::resume_unwind(Box::new("a step that fails"))).await;
        assert_eq!((broken, truth.outcome(1).await), (Err(WorldEnded), None));
    }
}
