//! Running a script: each of its threads is a future that the controller polls once in each control step.

use std::collections::{HashMap, HashSet};
use std::future::Future;
use std::pin::Pin;
use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::task::{Context, Poll, Waker};

use super::ast::{Function, Kind};
use super::eval::Frame;
use super::value::Value;
use crate::ur::robot::Robot;

/// Turns of loops and calls of functions in one control step, after which a script counts as hung.
pub(super) const BUDGET: u32 = 200_000;
/// Threads are at most so many.
pub(super) const MOST_THREADS: usize = 50;

/// Why a thread ends early.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum Ended {
    /// A runtime exception.
    Error { line: u32, what: String },
    /// `halt`.
    Halt,
}

pub(super) type Job = Pin<Box<dyn Future<Output = Result<(), Ended>> + Send>>;

/// What all threads of a program share.
pub(crate) struct Shared {
    robot: Arc<Mutex<Robot>>,
    pub(super) variables: Mutex<Variables>,
    pub(super) threads: Mutex<Threads>,
    pub(super) budget: AtomicU32,
    /// True for a secondary program: it may not move.
    pub(crate) secondary: bool,
}

#[derive(Default)]
pub(super) struct Variables {
    pub(super) globals: HashMap<String, Value>,
    /// Those of the program's own body.
    pub(super) program: HashMap<String, Value>,
    pub(super) functions: HashMap<String, Arc<Function>>,
}

#[derive(Default)]
pub(super) struct Threads {
    pub(super) started: Vec<(u32, Job)>,
    pub(super) alive: HashSet<u32>,
    pub(super) killed: HashSet<u32>,
    pub(super) next: u32,
}

pub(super) fn locked<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Shared {
    pub(crate) fn robot(&self) -> MutexGuard<'_, Robot> {
        locked(&self.robot)
    }
}

/// Waits for the next control step.
pub(crate) async fn next_step() {
    let mut asked = false;
    std::future::poll_fn(|_| {
        if asked {
            return Poll::Ready(());
        }
        asked = true;
        Poll::Pending
    })
    .await;
}

/// A program that runs.
pub(crate) struct Program {
    pub(crate) name: String,
    shared: Arc<Shared>,
    threads: Vec<(u32, Job)>,
}

/// What came of a step.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum Progress {
    Goes,
    Done,
    Failed { line: u32, what: String },
}

impl Program {
    pub(crate) fn start(program: Function, robot: Arc<Mutex<Robot>>) -> Self {
        let shared = Arc::new(Shared {
            robot,
            variables: Mutex::default(),
            threads: Mutex::new(Threads { next: 1, alive: HashSet::from([0]), ..Threads::default() }),
            budget: AtomicU32::new(0),
            secondary: program.secondary,
        });
        let name = program.name.clone();
        for statement in &program.body {
            if let Kind::Define(function) = &statement.kind {
                let mut variables = locked(&shared.variables);
                variables.functions.insert(function.name.clone(), function.clone());
            }
        }
        let theirs = shared.clone();
        let main: Job = Box::pin(async move {
            let mut frame = Frame::of_program(&theirs);
            frame.whole(&program.body).await
        });
        Self { name, shared, threads: vec![(0, main)] }
    }

    /// One control step. Threads that start in this step run in it, too.
    pub(crate) fn step(&mut self) -> Progress {
        self.shared.budget.store(0, Ordering::Relaxed);
        let mut context = Context::from_waker(Waker::noop());
        let mut ran = HashSet::new();
        loop {
            let (started, killed) = {
                let mut threads = locked(&self.shared.threads);
                (std::mem::take(&mut threads.started), std::mem::take(&mut threads.killed))
            };
            self.threads.extend(started);
            // Dropped without a lock: a motion that is dropped brakes the robot.
            self.threads.retain(|(id, _)| !killed.contains(id));
            let Some(at) = self.threads.iter().position(|(id, _)| !ran.contains(id)) else {
                return Progress::Goes;
            };
            let (id, job) = &mut self.threads[at];
            let id = *id;
            ran.insert(id);
            match job.as_mut().poll(&mut context) {
                Poll::Pending => {}
                Poll::Ready(Ok(())) if id == 0 => return Progress::Done,
                Poll::Ready(Err(Ended::Halt)) => return Progress::Done,
                Poll::Ready(Err(Ended::Error { line, what })) => return Progress::Failed { line, what },
                Poll::Ready(Ok(())) => {
                    locked(&self.shared.threads).alive.remove(&id);
                    drop(self.threads.remove(at));
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use std::time::Instant;

    use super::*;
    use crate::ur::plant::{JointServo, home};
    use crate::ur::script::parse;
    use crate::ur::settings::UrSettings;
    use proptest::prelude::*;

    fn robot() -> Arc<Mutex<Robot>> {
        let settings = UrSettings::default();
        let q = home(settings.model);
        Arc::new(Mutex::new(Robot::new(&settings, q, Box::new(JointServo::new(q)))))
    }

    fn ran(text: &str, steps: usize) -> Option<Progress> {
        let robot = robot();
        let mut program = Program::start(parse(text).ok()?, robot.clone());
        for _ in 0..steps {
            match program.step() {
                Progress::Goes => locked(&robot).step(),
                ended => return Some(ended),
            }
        }
        Some(Progress::Goes)
    }

    #[test]
    fn what_grows_without_end_is_ended() {
        for (text, expected) in [
            ("x = \"abc\"\nwhile True:\n x = x + x\nend", "a text that is too long"),
            ("x = [1]\nwhile True:\n x = [x, x]\nend", "a list that is too long"),
            ("x = [1, 2]\nwhile True:\n x[0] = x\n x[1] = x\nend", "too long for an item"),
            ("thread t():\n sleep(9)\nend\nwhile True:\n run t()\nend", "too many threads"),
        ] {
            let began = Instant::now();
            let ended = ran(text, 10);
            assert!(
                matches!(&ended, Some(Progress::Failed { what, .. }) if what.contains(expected)),
                "{ended:?}"
            );
            assert!(began.elapsed().as_secs() < 2);
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(200))]
        #[test]
        fn any_program_of_such_words_ends_or_goes_on(lines in prop::collection::vec(prop::sample::select(vec![
            "x = [1, 2, 3, 4, 5, 6]", "x = p[0.1, 0.2, 0.3, 0, 3.14, 0]", "x = x + 1", "x[0] = x", "x = x * x", "x = -x",
            "x = 1.0e308 * 10", "x = x / 0", "movej(x)", "movel(x)", "servoj(x)", "speedl(x)", "speedj(x, 1, 0.01)", "stopj(1)",
            "x = get_inverse_kin(x)", "x = get_forward_kin(x)", "x = pose_trans(x, x)", "x = pose_inv(x)", "sync()",
            "x = norm(x)", "set_tcp(x)", "x = run f(x)", "kill x", "join x", "while True:", "if x == x:", "end",
            "def f(x):", "return x", "x = f(x)", "halt", "break", "x = floor(x)", "x = x % -1", "x = -2147483647 - 1",
            "write_output_integer_register(x, x)", "set_digital_out(x, True)", "x = get_tcp_force()", "textmsg(x, x)",
        ]), 1..15)) {
            let mut text = "def f(x):\n return x\nend\nx = [0.1, -1.5, 1.5, -1.5, -1.5, 0.2]\n".to_owned();
            text.push_str(&lines.join("\n"));
            let opened = lines.iter().filter(|l| l.ends_with(':')).count();
            let closed = lines.iter().filter(|l| **l == "end").count();
            for _ in closed..opened {
                text.push_str("\nend");
            }
            let _ = ran(&text, 30);
        }
    }
}
