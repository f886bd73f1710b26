//! Plans that outcomes can be reported for: the latest in memory, older ones in the recording.

use std::collections::{HashMap, VecDeque};
use std::path::Path;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use graspd_proto::v1::PlanGraspsResponse;
use graspd_recording::{FoundPlan, PlanId, find_plan};
use tokio::sync::Semaphore;

use crate::error::ServiceError;

/// Plans and reports that are remembered.
const MOST: usize = 16_384;

/// An outcome and its note.
pub(super) type Said = (i32, String);

/// What is remembered.
#[derive(Debug)]
pub(super) struct Plans {
    plans: Mutex<Latest<PlanId, Arc<FoundPlan>>>,
    reports: Mutex<Latest<(PlanId, i32), Said>>,
    /// One look into files at a time: whoever makes up names costs no more than that.
    looking: Semaphore,
}

impl Default for Plans {
    fn default() -> Self {
        Self { plans: Mutex::default(), reports: Mutex::default(), looking: Semaphore::new(1) }
    }
}

/// The last entries of a map.
#[derive(Debug)]
struct Latest<K, V> {
    by_key: HashMap<K, V>,
    order: VecDeque<K>,
}

impl<K, V> Default for Latest<K, V> {
    fn default() -> Self {
        Self { by_key: HashMap::new(), order: VecDeque::new() }
    }
}

impl<K: Copy + Eq + std::hash::Hash, V> Latest<K, V> {
    fn insert(&mut self, key: K, value: V) {
        if self.by_key.insert(key, value).is_none() {
            self.order.push_back(key);
        }
        if self.order.len() > MOST
            && let Some(oldest) = self.order.pop_front()
        {
            self.by_key.remove(&oldest);
        }
    }
}

impl Plans {
    pub(super) fn remember(&self, answer: &PlanGraspsResponse) {
        let Some(id) = PlanId::parse(&answer.plan_id) else { return };
        let plan = FoundPlan {
            hand: answer.stats.as_ref().map(|s| s.hand.clone()).unwrap_or_default(),
            scores: answer.grasps.iter().map(|g| (g.uncalibrated_score, g.score)).collect(),
            calibration: answer.calibration.as_ref().map(|c| c.name.clone()).unwrap_or_default(),
        };
        lock(&self.plans).insert(id, Arc::new(plan));
    }

    pub(super) fn get(&self, id: PlanId) -> Option<Arc<FoundPlan>> {
        lock(&self.plans).by_key.get(&id).cloned()
    }

    /// Looks for a plan in the recording.
    pub(super) async fn look_for(
        &self,
        id: PlanId,
        folder: &Path,
    ) -> Result<Option<Arc<FoundPlan>>, ServiceError> {
        let fault = |what: String| ServiceError::Internal { what };
        let _one = self.looking.acquire().await.map_err(|e| fault(e.to_string()))?;
        let folder = folder.to_owned();
        let found = tokio::task::spawn_blocking(move || find_plan(&folder, id)).await;
        let found = found.map_err(|e| fault(e.to_string()))?;
        let found = found.map_err(|e| fault(format!("the recording cannot be read: {e}")))?.map(Arc::new);
        if let Some(plan) = &found {
            lock(&self.plans).insert(id, Arc::clone(plan));
        }
        Ok(found)
    }

    /// What was said last of a grasp.
    pub(super) fn reported(&self, key: (PlanId, i32)) -> Option<Said> {
        lock(&self.reports).by_key.get(&key).cloned()
    }

    pub(super) fn note_report(&self, key: (PlanId, i32), said: Said) {
        lock(&self.reports).insert(key, said);
    }
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_latest_are_remembered() {
        let plans = Plans::default();
        let id = |n: usize| PlanId::new(n as u64, [0; 10]);
        for n in 0..MOST + 10 {
            let answer = PlanGraspsResponse { plan_id: id(n).to_string(), ..Default::default() };
            plans.remember(&answer);
            plans.remember(&answer);
        }
        assert_eq!(lock(&plans.plans).order.len(), MOST);
        assert_eq!(lock(&plans.plans).by_key.len(), MOST);
        assert!(plans.get(id(9)).is_none() && plans.get(id(10)).is_some());
    }
}
