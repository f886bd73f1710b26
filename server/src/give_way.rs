//! Planning threads give way: a thread that answers does not wait for the end of their time slice.
//!
//! A time slice ends at a tick of the system's clock, on Linux up to 4 ms apart (`CONFIG_HZ=250`): niceness says who is next,
//! not when. So planning threads offer their core more often than that, in the looks at their budget. Where nobody else
//! wants it, that costs a microsecond.

use std::cell::Cell;
use std::time::{Duration, Instant};

/// So often a planning thread offers its core to others.
const EVERY: Duration = Duration::from_micros(500);

thread_local! {
    /// When this thread offered its core last; none where it does not.
    static OFFERED: Cell<Option<Instant>> = const { Cell::new(None) };
}

/// From now on this thread gives way. Under `shuttle` none does: schedules are made up there.
#[cfg_attr(feature = "shuttle", allow(dead_code))]
pub(crate) fn begin() {
    OFFERED.set(Some(Instant::now()));
}

/// Offers the core of this thread to others, if it is one that gives way and has had it for long. Not to be called with a
/// lock held: who waits for the lock would wait for everybody who takes the core.
pub(crate) fn give_way() {
    let Some(offered) = OFFERED.get() else { return };
    if offered.elapsed() >= EVERY {
        std::thread::yield_now();
        OFFERED.set(Some(Instant::now()));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// True if a look offers the core.
    fn offers() -> bool {
        let before = OFFERED.get();
        give_way();
        OFFERED.get() != before
    }

    #[test]
    fn only_planning_threads_give_way_and_only_now_and_then() {
        std::thread::spawn(|| {
            assert!(!offers());
            std::thread::sleep(2 * EVERY);
            assert!(!offers(), "a thread that answers keeps its core");
            begin();
            std::thread::sleep(2 * EVERY);
            assert!(offers());
            OFFERED.set(Some(Instant::now() + Duration::from_secs(60)));
            assert!(!offers(), "not at every look");
        })
        .join()
        .unwrap();
    }
}
