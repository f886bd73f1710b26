//! The emulated controller's clock: runs programs and motion step by step.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use tokio::sync::{mpsc, watch};

use super::robot::{Message, Robot};
use super::script::{Program, Progress, parse};

/// Steps that are caught up at most after a pause of the whole process.
const CATCH_UP: u32 = 50;

pub(crate) struct Controller {
    pub(crate) robot: Arc<Mutex<Robot>>,
    pub(crate) steps: watch::Sender<u64>,
    pub(crate) scripts: mpsc::UnboundedReceiver<String>,
    pub(crate) program: Option<Program>,
    pub(crate) secondary: Vec<Program>,
}

impl Controller {
    fn robot(&self) -> MutexGuard<'_, Robot> {
        self.robot.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Runs for ever.
    pub(crate) async fn run(mut self) {
        let step = Duration::from_secs_f64(self.robot().step_s);
        let mut clock = tokio::time::interval(step);
        clock.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Skip);
        let mut due = Instant::now();
        loop {
            clock.tick().await;
            let mut caught = 0;
            while due <= Instant::now() {
                due += step;
                caught += 1;
                if caught > CATCH_UP {
                    due = Instant::now() + step;
                    break;
                }
                self.step();
            }
            let steps = self.robot().steps;
            self.steps.send_replace(steps);
        }
    }

    fn step(&mut self) {
        while let Ok(text) = self.scripts.try_recv() {
            self.load(&text);
        }
        let (stop, paused) = {
            let mut robot = self.robot();
            (std::mem::take(&mut robot.stop_program), robot.runtime == 4)
        };
        if stop {
            self.end_program("stopped");
        }
        if !paused && let Some(program) = &mut self.program {
            let progress = program.step();
            match progress {
                Progress::Goes => {}
                Progress::Done => self.end_program("done"),
                Progress::Failed { line, what } => {
                    self.robot().tell(Message::Exception { line: line as i32, text: what.clone() });
                    tracing::debug!(line, what, "emulated script failed");
                    self.end_program("failed");
                }
            }
        }
        let robot = self.robot.clone();
        self.secondary.retain_mut(|program| match program.step() {
            Progress::Goes => true,
            Progress::Done => false,
            Progress::Failed { line, what } => {
                let robot = robot.lock().unwrap_or_else(PoisonError::into_inner);
                robot.tell(Message::Exception { line: line as i32, text: what });
                false
            }
        });
        self.robot().step();
    }

    fn load(&mut self, text: &str) {
        let (remote, can_move) = {
            let robot = self.robot();
            (robot.remote, robot.can_move())
        };
        if !remote {
            let text = "the interface is read-only: the robot is not in remote control".into();
            self.robot().tell(Message::Error { code: 210, argument: 0, text });
            return;
        }
        let function = match parse(text) {
            Ok(function) => function,
            Err(error) => {
                tracing::debug!(%error, "emulated script does not parse");
                let message = Message::Exception { line: error.line as i32, text: error.what };
                self.robot().tell(message);
                return;
            }
        };
        if function.secondary {
            self.secondary.push(Program::start(function, self.robot.clone()));
            return;
        }
        self.end_program("replaced");
        if !can_move {
            let text = "a program was sent while the robot cannot move".into();
            self.robot().tell(Message::Error { code: 204, argument: 0, text });
            return;
        }
        let program = Program::start(function, self.robot.clone());
        let title = format!("PROGRAM_XXX_STARTED{}", program.name);
        {
            let mut robot = self.robot();
            robot.runtime = 2;
            robot.watchdog = None;
            robot.tell(Message::Key { title, text: program.name.clone() });
        }
        self.program = Some(program);
    }

    fn end_program(&mut self, why: &'static str) {
        // Dropped without the lock: a motion under way brakes.
        let ended = self.program.take();
        let mut name = None;
        if let Some(program) = ended {
            tracing::debug!(name = program.name, why, "emulated program ended");
            name = Some(program.name.clone());
            drop(program);
        }
        let mut robot = self.robot();
        if robot.runtime != 1 || name.is_some() {
            robot.runtime = 1;
            robot.watchdog = None;
            if !robot.mover.is_standing() {
                robot.mover.brake();
            }
            if let Some(name) = name {
                let title = format!("PROGRAM_XXX_STOPPED{name}");
                robot.tell(Message::Key { title, text: name });
            }
        }
    }
}
