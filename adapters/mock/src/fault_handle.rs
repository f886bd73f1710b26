//! Changing a device's faults while it runs, and what the device asks about them.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use rand::{RngExt, SeedableRng};
use rand_xoshiro::Xoshiro256PlusPlus;

use crate::clock::Clock;
use crate::faults::{After, Faults, FaultsError, Overload, Spell, StopKind};

/// Changes the faults of one device at run time. Clones change the same device.
#[derive(Debug, Clone)]
pub struct FaultHandle {
    clock: Arc<Clock>,
    state: Arc<Mutex<State>>,
}

#[derive(Debug, Default)]
struct State {
    faults: Faults,
    refused_since_s: f64,
    silent_since_s: f64,
    stuck_since_s: f64,
    calls: u64,
}

/// What comes of one frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Fate {
    /// It arrives this many seconds after exposure.
    Arrives(f64),
    /// It never arrives.
    Lost,
    /// It is not taken: an exposure made at this time comes again.
    Stuck(f64),
}

impl FaultHandle {
    pub(crate) fn new(clock: Arc<Clock>, faults: Faults) -> Result<Self, FaultsError> {
        let handle = Self { clock, state: Arc::default() };
        handle.set(faults)?;
        Ok(handle)
    }

    /// The faults as they stand: what has happened already is no longer in them (calls are counted down, faults
    /// that happen once are gone).
    pub fn get(&self) -> Faults {
        self.lock().faults.clone()
    }

    /// Puts other faults in the place of all.
    ///
    /// # Errors
    /// [`FaultsError`]: a number is impossible; nothing is changed.
    pub fn set(&self, faults: Faults) -> Result<(), FaultsError> {
        self.update(|f| *f = faults)
    }

    /// Ends every fault.
    pub fn clear(&self) {
        let seed = self.lock().faults.seed;
        // The default passes every check.
        let _always_fine = self.set(Faults { seed, ..Faults::default() });
    }

    /// Changes some faults.
    ///
    /// # Errors
    /// [`FaultsError`]: a number is impossible; nothing is changed.
    pub fn update(&self, change: impl FnOnce(&mut Faults)) -> Result<(), FaultsError> {
        let now_s = self.clock.now_s();
        let mut state = self.lock();
        let mut faults = state.faults.clone();
        change(&mut faults);
        faults.check()?;
        if faults.refused != state.faults.refused {
            state.refused_since_s = now_s;
        }
        if faults.silent != state.faults.silent {
            state.silent_since_s = now_s;
        }
        if faults.stuck && !state.faults.stuck {
            state.stuck_since_s = now_s;
        }
        state.faults = faults;
        Ok(())
    }

    /// Counts a call; true when it is refused.
    pub(crate) fn refuses(&self) -> bool {
        let now_s = self.clock.now_s();
        let mut state = self.lock();
        let since_s = state.refused_since_s;
        applies(&mut state.faults.refused, now_s - since_s)
    }

    /// Counts a call; true when it is not answered.
    pub(crate) fn is_silent(&self) -> bool {
        let now_s = self.clock.now_s();
        let mut state = self.lock();
        let since_s = state.silent_since_s;
        applies(&mut state.faults.silent, now_s - since_s)
    }

    /// True when an answer is lost on its way back: silence that lasts for a time covers it. Counts no call.
    pub(crate) fn loses_answers(&self) -> bool {
        let now_s = self.clock.now_s();
        let state = self.lock();
        match state.faults.silent {
            Some(Spell::Forever) => true,
            Some(Spell::Seconds(limit)) => now_s - state.silent_since_s < limit,
            Some(Spell::Calls(_)) | None => false,
        }
    }

    /// Latency of the next call, seconds.
    pub(crate) fn call_latency_s(&self) -> f64 {
        let mut state = self.lock();
        state.calls += 1;
        let mut random = draw(state.faults.seed, 1, state.calls);
        state.faults.latency_s + state.faults.jitter_s * random.random::<f64>()
    }

    /// What comes of the frame with this number.
    pub(crate) fn fate(&self, sequence: u64) -> Fate {
        let state = self.lock();
        let faults = &state.faults;
        if faults.stuck {
            return Fate::Stuck(state.stuck_since_s);
        }
        let mut random = draw(faults.seed, 2, sequence);
        let (lost, late, jitter): (f64, f64, f64) = random.random();
        if lost < faults.drop_share {
            return Fate::Lost;
        }
        let extra = faults.stale.filter(|s| late < s.share).map_or(0.0, |s| s.age_s);
        Fate::Arrives(faults.latency_s + faults.jitter_s * jitter + extra)
    }

    /// Seed of the noise of the frame with this number.
    pub(crate) fn noise_seed(&self, sequence: u64) -> u64 {
        draw(self.lock().faults.seed, 3, sequence).random()
    }

    /// True while the emergency stop is pressed.
    pub(crate) fn emergency_stop(&self) -> bool {
        self.lock().faults.emergency_stop
    }

    /// The stop that is due this far into a motion, and what set it off; it is then used up.
    pub(crate) fn motion_stop(&self, path_m: f64, seconds: f64) -> Option<StopKind> {
        let mut state = self.lock();
        let fault = state.faults.motion?;
        let due = match fault.after {
            After::Metres(limit) => path_m >= limit,
            After::Seconds(limit) => seconds >= limit,
        };
        if !due {
            return None;
        }
        state.faults.motion = None;
        if fault.kind == StopKind::Emergency {
            state.faults.emergency_stop = true;
        }
        Some(fault.kind)
    }

    /// True when a motor is overloaded this far into a grip; the fault is then used up.
    pub(crate) fn overloads(&self, seconds: f64) -> bool {
        let mut state = self.lock();
        let due = state.faults.overload.is_some_and(|Overload { after_s }| seconds >= after_s);
        if due {
            state.faults.overload = None;
        }
        due
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        // No code that holds the lock can leave it half changed.
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// True when a spell covers this call; counts it down, and takes it away when it is over.
fn applies(spell: &mut Option<Spell>, seconds: f64) -> bool {
    match spell {
        None => false,
        Some(Spell::Forever) => true,
        Some(Spell::Calls(left)) => {
            let covered = *left > 0;
            *left = left.saturating_sub(1);
            if *left == 0 {
                *spell = None;
            }
            covered
        }
        Some(Spell::Seconds(limit)) => {
            let covered = seconds < *limit;
            if !covered {
                *spell = None;
            }
            covered
        }
    }
}

/// A random source of its own for each purpose and number, so that what is drawn does not depend on the order of
/// calls.
fn draw(seed: u64, purpose: u64, number: u64) -> Xoshiro256PlusPlus {
    let mixed = seed
        .wrapping_mul(0x9E37_79B9_7F4A_7C15)
        .wrapping_add(purpose.wrapping_mul(0xD1B5_4A32_D192_ED03))
        .wrapping_add(number.wrapping_mul(0x8CB9_2BA7_2F3D_8DD7));
    Xoshiro256PlusPlus::seed_from_u64(mixed)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::faults::{MotionFault, Stale};

    fn handle(faults: Faults) -> (Arc<Clock>, FaultHandle) {
        let clock = Arc::new(Clock::default());
        (clock.clone(), FaultHandle::new(clock, faults).unwrap())
    }

    #[test]
    fn spells_end_by_calls_or_by_time() {
        let (clock, faults) = handle(Faults { refused: Some(Spell::Calls(2)), ..Faults::default() });
        assert_eq!([(); 4].map(|()| faults.refuses()), [true, true, false, false]);
        assert_eq!(faults.get().refused, None);
        clock.set(5.0);
        faults.update(|f| f.silent = Some(Spell::Seconds(1.0))).unwrap();
        assert!(faults.is_silent());
        clock.set(5.9);
        assert!(faults.is_silent());
        clock.set(6.0);
        assert!(!faults.is_silent() && faults.get().silent.is_none());
    }

    #[test]
    fn shares_are_kept_and_do_not_depend_on_order() {
        let stale = Some(Stale { share: 0.25, age_s: 1.0 });
        let (_, faults) =
            handle(Faults { seed: 7, drop_share: 0.3, stale, jitter_s: 0.01, ..Faults::default() });
        let fates: Vec<_> = (0..4000).map(|n| faults.fate(n)).collect();
        let lost = fates.iter().filter(|f| **f == Fate::Lost).count() as f64 / 4000.0;
        let late =
            fates.iter().filter(|f| matches!(f, Fate::Arrives(s) if *s >= 1.0)).count() as f64 / 4000.0;
        assert!((lost - 0.3).abs() < 0.03, "lost {lost}");
        assert!((late - 0.7 * 0.25).abs() < 0.03, "late {late}");
        assert_eq!(faults.fate(17), fates[17]);
        let jitters: Vec<_> = (0..100).map(|_| faults.call_latency_s()).collect();
        assert!(jitters.iter().all(|j| (0.0..=0.01).contains(j)) && jitters[0] != jitters[1]);
    }

    #[test]
    fn what_happens_once_is_used_up() {
        let motion = Some(MotionFault { after: After::Metres(0.1), kind: StopKind::Emergency });
        let (_, faults) =
            handle(Faults { motion, overload: Some(Overload { after_s: 0.5 }), ..Faults::default() });
        assert_eq!(faults.motion_stop(0.05, 9.0), None);
        assert_eq!(faults.motion_stop(0.11, 0.0), Some(StopKind::Emergency));
        assert!(faults.emergency_stop());
        assert_eq!(faults.motion_stop(0.2, 0.0), None);
        assert!(!faults.overloads(0.4) && faults.overloads(0.5) && !faults.overloads(1.0));
        faults.clear();
        assert_eq!(faults.get(), Faults::default());
    }

    #[test]
    fn an_impossible_change_changes_nothing() {
        let (_, faults) = handle(Faults::default());
        assert!(faults.update(|f| f.drop_share = 2.0).is_err());
        assert_eq!(faults.get(), Faults::default());
    }
}
