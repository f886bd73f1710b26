//! How `graspd` takes, keeps and gives back memory.
//!
//! Volumes of some megabytes come and go with every plan, on many threads. The C library's allocator keeps them in each
//! thread's arena, so that a server that is under load for long has several times the memory that it needs. mimalloc
//! shares them; but what nobody used for a second it hands back to the system, dozens of megabytes at once, in whichever
//! thread happens to allocate: threads that answer then stood still for 5 to 30 ms. So here they hand nothing
//! back, and one thread does that has nothing else to do. `docs/load.md` has the figures.

use std::ffi::{c_int, c_long};
use std::thread;
use std::time::Duration;

#[global_allocator]
static MEMORY: mimalloc::MiMalloc = mimalloc::MiMalloc;

/// `mi_option_purge_delay` of mimalloc 3: milliseconds after which free memory is handed back.
const PURGE_DELAY: c_int = 15;
/// In practice never: less than 0 would forbid it to everybody.
const MUCH_LATER: c_long = 7 * 24 * 3600 * 1000;
/// So often that thread gives back what nobody uses.
const EVERY: Duration = Duration::from_secs(60);
/// How much nicer that is than what answers: as nice as can be.
#[cfg(target_os = "linux")]
const NICE: i32 = 19;

/// No thread hands memory back by the way, unless the environment (`MIMALLOC_PURGE_DELAY`) says when it should. To be called
/// once, before there are other threads.
pub(crate) fn keep() {
    // SAFETY: sets one number of a table that mimalloc has from the start, and does nothing where there is no such entry.
    // The table is not synchronized: no other thread runs yet.
    #[allow(unsafe_code)]
    unsafe {
        libmimalloc_sys::mi_option_set_default(PURGE_DELAY, MUCH_LATER);
    }
}

/// Starts the thread that hands back what nobody uses. Without it, or where the environment says when, memory that was needed
/// once is kept.
pub(crate) fn give_back_now_and_then() {
    if purge_delay() != MUCH_LATER {
        return;
    }
    let started = thread::Builder::new().name("memory".to_owned()).spawn(|| {
        // Where it is refused, others wait for this thread for some milliseconds once a minute.
        #[cfg(target_os = "linux")]
        rustix::process::setpriority_process(None, NICE).ok();
        loop {
            thread::sleep(EVERY);
            give_back();
        }
    });
    if let Err(error) = started {
        tracing::warn!(%error, "memory that was needed once is kept: its thread does not start");
    }
}

/// Hands back what nobody uses.
fn give_back() {
    // SAFETY: works on this thread's own heap and on what is free in what all threads share, whose bitmaps are atomic; nothing
    // that is in use is touched.
    #[allow(unsafe_code)]
    unsafe {
        libmimalloc_sys::mi_collect(true);
    }
}

fn purge_delay() -> c_long {
    // SAFETY: reads one number of mimalloc's table, which nobody writes after `keep`.
    #[allow(unsafe_code)]
    unsafe {
        libmimalloc_sys::mi_option_get(PURGE_DELAY)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::process::Command;

    /// Volumes of a plan, and how many of them there are at a time.
    #[cfg(target_os = "linux")]
    const VOLUME: usize = 4 << 20;
    #[cfg(target_os = "linux")]
    const VOLUMES: usize = 32;

    /// Resident memory: in kibibytes there, however large pages are.
    #[cfg(target_os = "linux")]
    fn resident_bytes() -> usize {
        let status = std::fs::read_to_string("/proc/self/status").unwrap();
        let line = status.lines().find(|line| line.starts_with("VmRSS:")).unwrap();
        line.split_whitespace().nth(1).unwrap().parse::<usize>().unwrap() * 1024
    }

    /// A process of its own, in which nothing else runs beside it.
    #[test]
    #[ignore = "run by the test below"]
    fn in_a_process_of_its_own() {
        let before = purge_delay();
        keep();
        println!("[{before} {}]", purge_delay());
        #[cfg(target_os = "linux")]
        if before == 1000 {
            let volumes: Vec<Vec<u8>> = (0..VOLUMES).map(|_| vec![1; VOLUME]).collect();
            let used = resident_bytes();
            // Another thread frees them, as in a server.
            thread::spawn(move || drop(volumes)).join().unwrap();
            thread::sleep(Duration::from_millis(1500));
            drop(vec![1u8; VOLUME]);
            assert!(resident_bytes() + VOLUME > used, "nobody hands it back by the way");
            give_back();
            assert!(resident_bytes() + VOLUMES * VOLUME * 3 / 4 < used, "{used} then {}", resident_bytes());
        }
    }

    fn told(purge_delay: Option<&str>) -> String {
        let mut command = Command::new(std::env::current_exe().unwrap());
        command.args(["--exact", "memory::tests::in_a_process_of_its_own", "--ignored", "--nocapture"]);
        command.env_remove("MIMALLOC_PURGE_DELAY");
        command.envs(purge_delay.map(|value| ("MIMALLOC_PURGE_DELAY", value)));
        let output = command.output().unwrap();
        assert!(output.status.success(), "{output:?}");
        let output = String::from_utf8(output.stdout).unwrap();
        let (_, rest) = output.split_once('[').unwrap_or_else(|| panic!("{output}"));
        rest.split_once(']').unwrap().0.to_owned()
    }

    #[test]
    fn memory_is_handed_back_by_its_thread_alone_unless_the_environment_says_otherwise() {
        assert_eq!(told(None), format!("1000 {MUCH_LATER}"), "mimalloc's own second, then ours");
        // By this name: the number is that of no other option.
        assert_eq!(told(Some("77")), "77 77");
    }
}
