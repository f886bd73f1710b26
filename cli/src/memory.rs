//! How `graspd` takes and keeps memory.
//!
//! Volumes of some megabytes come and go with every plan, on many threads. The C library's allocator keeps them in each
//! thread's arena, so that a server that is under load for long has several times the memory that it needs. mimalloc
//! shares them; but what nobody used for a second it hands back to the system, dozens of megabytes at once, in whichever
//! thread happens to allocate: a thread that answers then stood still for 5 to 30 ms, and the next plan paid for the same
//! pages again. So what the program once needed, it keeps. `docs/load.md` has the figures.

use std::ffi::{c_int, c_long};

#[global_allocator]
static MEMORY: mimalloc::MiMalloc = mimalloc::MiMalloc;

/// `mi_option_purge_delay` of mimalloc 3: milliseconds after which free memory is handed back, or less than 0 for never.
const PURGE_DELAY: c_int = 15;
const NEVER: c_long = -1;

/// Memory that was needed once is kept for the next plan, unless the environment (`MIMALLOC_PURGE_DELAY`) says otherwise.
/// To be called once, before there are other threads.
pub(crate) fn keep() {
    // SAFETY: sets one number of a table that mimalloc has from the start, and does nothing where there is no such entry.
    // The table is not synchronized: no other thread runs yet.
    #[allow(unsafe_code)]
    unsafe {
        libmimalloc_sys::mi_option_set_default(PURGE_DELAY, NEVER);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::process::Command;

    fn purge_delay() -> c_long {
        // SAFETY: reads one number of mimalloc's table, after its only writer above.
        #[allow(unsafe_code)]
        unsafe {
            libmimalloc_sys::mi_option_get(PURGE_DELAY)
        }
    }

    /// A process of its own, in which nothing else runs beside it.
    #[test]
    #[ignore = "run by the test below"]
    fn in_a_process_of_its_own() {
        let before = purge_delay();
        keep();
        println!("[{before} {}]", purge_delay());
    }

    fn told(purge_delay: Option<&str>) -> String {
        let mut command = Command::new(std::env::current_exe().unwrap());
        command.args(["--exact", "memory::tests::in_a_process_of_its_own", "--ignored", "--nocapture"]);
        command.env_remove("MIMALLOC_PURGE_DELAY");
        command.envs(purge_delay.map(|value| ("MIMALLOC_PURGE_DELAY", value)));
        let output = String::from_utf8(command.output().unwrap().stdout).unwrap();
        let (_, rest) = output.split_once('[').unwrap_or_else(|| panic!("{output}"));
        rest.split_once(']').unwrap().0.to_owned()
    }

    #[test]
    fn memory_is_kept_unless_the_environment_says_otherwise() {
        assert_eq!(told(None), "1000 -1", "mimalloc's own second, then ours");
        // By this name: the number is that of no other option.
        assert_eq!(told(Some("77")), "77 77");
    }
}
