//! Scenes that several calls share: the same frames, read in the same way by the same estimator, make one volume
//! and one inference, however many calls bring them at the same time.
//!
//! Frames are the same when their bytes are: candidates are found by a hash of samples and then compared whole, so
//! nobody gets the scene of another frame. A scene is kept for as long as a call that needs it lives, and no
//! longer. One job reads it; the others wait behind a [gate](crate::pool::Gate) that takes no slot.

use std::collections::HashMap;
use std::hash::{BuildHasher as _, Hash as _, Hasher as _, RandomState};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, OnceLock, PoisonError, Weak};
use std::time::{Duration, Instant};

use graspd_planner::budget::{Budget, Stop};
use graspd_planner::estimator::ContactEstimator;

use crate::convert::SceneRequest;
use crate::deadline::CallBudget;
use crate::engine::ReadScene;
use crate::give_way::give_way;
use crate::pool::{Gate, Look};

/// Scenes that calls need now.
#[derive(Debug, Default)]
pub(crate) struct Scenes {
    /// A hash that callers cannot foresee.
    hasher: RandomState,
    alive: Mutex<HashMap<u64, Vec<Weak<SharedScene>>>>,
    /// Scenes that were read.
    read: Arc<AtomicU64>,
}

impl Scenes {
    /// The scene of a request: that of a call with the same frames, or a new one.
    pub(crate) fn get(
        &self,
        request: &Arc<SceneRequest>,
        estimator: Arc<dyn ContactEstimator>,
    ) -> Arc<SharedScene> {
        let key = self.key(request, estimator.name());
        let mut alive = self.alive.lock().unwrap_or_else(PoisonError::into_inner);
        alive.retain(|_, scenes| {
            scenes.retain(|scene| scene.strong_count() > 0);
            !scenes.is_empty()
        });
        let same = alive.entry(key).or_default();
        let found = same
            .iter()
            .filter_map(Weak::upgrade)
            .find(|scene| scene.estimator.name() == estimator.name() && scene.request.is_same_scene(request));
        found.unwrap_or_else(|| {
            let scene = Arc::new(SharedScene {
                room: request.room(),
                request: Arc::clone(request),
                estimator,
                state: Mutex::new(State::Unread),
                wanted: Mutex::default(),
                read_count: Arc::clone(&self.read),
            });
            same.push(Arc::downgrade(&scene));
            scene
        })
    }

    /// Scenes that were read so far.
    pub(crate) fn read_count(&self) -> u64 {
        self.read.load(Ordering::Relaxed)
    }

    fn key(&self, request: &SceneRequest, estimator: &str) -> u64 {
        let mut hasher = self.hasher.build_hasher();
        estimator.hash(&mut hasher);
        for frame in &request.frames {
            frame.hash_samples(&mut hasher);
        }
        hasher.finish()
    }
}

/// A scene that one or several calls need.
pub(crate) struct SharedScene {
    /// The frames and how they are read.
    pub(crate) request: Arc<SceneRequest>,
    /// What finds contacts in it.
    pub(crate) estimator: Arc<dyn ContactEstimator>,
    room: usize,
    state: Mutex<State>,
    /// Budgets of the calls that need it.
    wanted: Mutex<Vec<CallBudget>>,
    read_count: Arc<AtomicU64>,
}

enum State {
    Unread,
    Reading,
    Read(Arc<ReadScene>),
}

impl SharedScene {
    /// A call needs the scene for as long as its budget lasts.
    pub(crate) fn want(&self, budget: &CallBudget) {
        let mut wanted = self.wanted.lock().unwrap_or_else(PoisonError::into_inner);
        wanted.retain(|b| b.stop().is_none());
        wanted.push(budget.clone());
    }

    /// The scene, if it has been read.
    pub(crate) fn read(&self) -> Option<Arc<ReadScene>> {
        match &*self.state() {
            State::Read(scene) => Some(Arc::clone(scene)),
            State::Unread | State::Reading => None,
        }
    }

    /// True if nobody has begun to read it.
    pub(crate) fn is_unread(&self) -> bool {
        matches!(*self.state(), State::Unread)
    }

    /// Begins to read; the scene is unread again if the guard is dropped without a scene.
    pub(crate) fn reading(self: &Arc<Self>) -> Reading {
        *self.state() = State::Reading;
        Reading { scene: Arc::clone(self), began: Instant::now(), ended: OnceLock::new() }
    }

    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Gate for SharedScene {
    fn look(&self) -> Look {
        match *self.state() {
            State::Unread => Look::Needs(self.room),
            State::Reading => Look::Shut,
            State::Read(_) => Look::Open,
        }
    }

    fn begin(&self) {
        *self.state() = State::Reading;
    }
}

impl std::fmt::Debug for SharedScene {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("SharedScene").field("room", &self.room).finish_non_exhaustive()
    }
}

/// Somebody reads the scene, for everybody who needs it: work goes on until the last of their budgets has ended.
pub(crate) struct Reading {
    scene: Arc<SharedScene>,
    began: Instant,
    /// Set when nobody was left: who comes later begins anew, since something may have been left out.
    ended: OnceLock<Stop>,
}

impl Reading {
    /// The scene is read.
    pub(crate) fn done(self, read: ReadScene) -> Arc<ReadScene> {
        let read = Arc::new(read);
        self.scene.read_count.fetch_add(1, Ordering::Relaxed);
        *self.scene.state() = State::Read(Arc::clone(&read));
        read
    }
}

impl Drop for Reading {
    fn drop(&mut self) {
        let mut state = self.scene.state();
        if matches!(*state, State::Reading) {
            *state = State::Unread;
        }
    }
}

impl Budget for Reading {
    fn elapsed(&self) -> Duration {
        self.began.elapsed()
    }

    fn stop(&self) -> Option<Stop> {
        give_way();
        if let Some(ended) = self.ended.get() {
            return Some(*ended);
        }
        let wanted = self.scene.wanted.lock().unwrap_or_else(PoisonError::into_inner);
        let mut all = Some(Stop::Cancelled);
        for budget in wanted.iter() {
            match budget.ended() {
                None => return None,
                Some(Stop::Deadline) => all = Some(Stop::Deadline),
                Some(Stop::Cancelled) => {}
            }
        }
        // Threads that ask at the same time hear the same.
        all.map(|stop| *self.ended.get_or_init(|| stop))
    }
}
