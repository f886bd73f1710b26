//! An arm in a task of its own: it hears orders, and tells what becomes of them.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use tokio::sync::mpsc;

use crate::config::CellConfig;
use crate::observer::{Event, Observer};
use crate::outcome::{End, Holding, Outcome};
use crate::plan::HandFacts;
use crate::report::Report;
use crate::run::{Cell, CellError, Chosen, Picker};
use crate::steps::Step;

/// What an arm is told.
#[derive(Debug)]
pub(super) enum Order {
    /// Go home, by way of the bin the first time.
    Home,
    /// Take this.
    Pick(Box<Chosen>),
    /// Try to work again after having been lost.
    ComeBack,
    /// The run is over.
    End(End),
}

/// What an arm tells.
#[derive(Debug)]
pub(super) enum Notice {
    /// A step begins: it lives.
    Step(Step),
    /// It has an object above everything that stands, and does not go down again before its bin.
    Lifted,
    /// It has left the space over the tray: it is where it lets go.
    Left,
    /// Trouble, in words.
    Trouble(String),
    /// The pick is over; it goes home now. With its trials and successes.
    Picked { outcome: Outcome, trials: u32, successes: u32 },
    /// It is at home.
    Home,
    /// It does not do what it is asked.
    Lost { end: End, holding: Holding },
    /// Its run has ended.
    Ended(Box<Report>),
}

/// Tells the others what the arm does.
struct Eyes {
    arm: usize,
    tell: mpsc::UnboundedSender<(usize, Notice)>,
    stop: Arc<AtomicBool>,
}

impl Observer for Eyes {
    fn on(&mut self, event: &Event<'_>) {
        let notice = match event {
            Event::StepBegan { step, .. } => Notice::Step(*step),
            Event::StepEnded { record, .. } if record.step == Step::CheckHeld && record.done => {
                Notice::Lifted
            }
            // Over the bin; what comes then is on the arm's own ground.
            Event::StepEnded { record, .. } if record.step == Step::Carry && record.done => Notice::Left,
            Event::Trouble { step, text, .. } => Notice::Trouble(format!("{step}: {text}")),
            _ => return,
        };
        // Nobody listens any more only when the run is over.
        self.tell.send((self.arm, notice)).ok();
    }

    fn wants_end(&self) -> bool {
        self.stop.load(Ordering::Relaxed)
    }
}

/// What a worker is made of.
#[derive(Debug)]
pub(super) struct Worker {
    pub(super) arm: usize,
    pub(super) cell: Cell,
    pub(super) config: CellConfig,
    pub(super) facts: HandFacts,
    pub(super) orders: mpsc::UnboundedReceiver<Order>,
    pub(super) tell: mpsc::UnboundedSender<(usize, Notice)>,
    pub(super) stop: Arc<AtomicBool>,
}

impl Worker {
    /// Works until it is told that the run is over, or nobody is there to tell.
    ///
    /// # Errors
    /// [`CellError`] before anything moves.
    pub(super) async fn work(mut self) -> Result<(), CellError> {
        let (arm, tell) = (self.arm, self.tell.clone());
        // Nobody listens any more only when the run is over.
        let say = |notice| tell.send((arm, notice)).ok();
        let mut eyes = Eyes { arm, tell: self.tell.clone(), stop: self.stop.clone() };
        let mut picker = Picker::new(&self.cell, &self.config, self.facts.clone(), &mut eyes)?;
        while let Some(order) = self.orders.recv().await {
            let done = match order {
                Order::Home => picker.go_home().await,
                Order::ComeBack => picker.come_back().await,
                Order::Pick(chosen) => match picker.pick(*chosen).await {
                    Ok(outcome) => {
                        let (trials, successes) = (picker.tally().trials, picker.tally().successes);
                        say(Notice::Picked { outcome, trials, successes });
                        picker.go_home().await
                    }
                    Err(end) => Err(end),
                },
                Order::End(end) => {
                    let report = picker.end(end).await;
                    say(Notice::Ended(Box::new(report)));
                    return Ok(());
                }
            };
            say(match done {
                Ok(()) => Notice::Home,
                Err(end) => Notice::Lost { end, holding: picker.holding() },
            });
        }
        Ok(())
    }
}
