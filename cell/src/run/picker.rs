//! One arm of several: it takes the grasps that somebody else has chosen for it, with the steps and the recoveries of a run.

use nalgebra::Isometry3;

use super::{Attempt, Cell, CellError, Next, Run};
use crate::config::CellConfig;
use crate::frame::Frame;
use crate::observer::Observer;
use crate::outcome::{End, Holding, Outcome};
use crate::plan::{Answer, HandFacts, Question};
use crate::record::OutOfReach;
use crate::report::{Report, Tally};
use crate::steps::Step;

/// What an arm is given.
#[derive(Debug, Clone)]
pub(crate) struct Chosen {
    /// What was planned from.
    pub(crate) frame: Frame,
    /// What was asked.
    pub(crate) question: Question,
    /// What was answered.
    pub(crate) answer: Answer,
    /// Grasps that the arm does not reach.
    pub(crate) out_of_reach: Vec<OutOfReach>,
    /// The grasp, by its rank.
    pub(crate) rank: usize,
    /// Pose of the hand's root link where it lets go.
    pub(crate) drop: Isometry3<f64>,
}

/// An arm that is led.
pub(crate) struct Picker<'a> {
    run: Run<'a>,
}

impl<'a> Picker<'a> {
    /// Nothing moves yet.
    pub(crate) fn new(
        cell: &'a Cell,
        config: &'a CellConfig,
        facts: HandFacts,
        observer: &'a mut dyn Observer,
    ) -> Result<Self, CellError> {
        let mut run = Run::new(cell, config, facts, observer)?;
        run.led = true;
        Ok(Self { run })
    }

    /// Up, out of the view, home; the first time by way of the drop pose, where the hand opens.
    pub(crate) async fn go_home(&mut self) -> Result<(), End> {
        self.run.attempt.steps.clear();
        self.run.enter(Step::ClearView);
        loop {
            match self.run.one_step().await {
                Next::Again => {}
                Next::Go(_) => {
                    // What it did between two attempts belongs to none of them.
                    self.run.attempt.steps.clear();
                    return Ok(());
                }
                Next::Finished(_) => return Ok(()),
                Next::End(end) => return Err(end),
            }
        }
    }

    /// Executes one grasp: from opening the hand to letting go, or to the end of the retreat. An end is one of the arm, not
    /// of the others.
    pub(crate) async fn pick(&mut self, chosen: Chosen) -> Result<Outcome, End> {
        let run = &mut self.run;
        run.idle_attempts = 0;
        run.places.drop = chosen.drop;
        let mut attempt = Attempt::new(run.attempt.number);
        if let Some(recorder) = &run.recorder {
            let kept = recorder.frame(attempt.number, &chosen.frame);
            run.note(kept);
        }
        attempt.frame = Some(chosen.frame);
        attempt.question = Some(chosen.question);
        attempt.take(chosen.answer, chosen.out_of_reach, &[]);
        attempt.choose(chosen.rank);
        run.attempt = attempt;
        run.enter(Step::Open);
        loop {
            match run.one_step().await {
                Next::Again => {}
                // Whoever leads it looks.
                Next::Go(Step::ClearView) => return Ok(Outcome::NotExecuted { why: "given up".to_owned() }),
                Next::Go(step) => run.enter(step),
                Next::Finished(outcome) => {
                    let told = outcome.clone();
                    let end = run.finish_attempt(outcome).await;
                    run.attempt = Attempt::new(run.attempt.number + 1);
                    return end.map_or(Ok(told), Err);
                }
                Next::End(end) => return Err(end),
            }
        }
    }

    /// After an end: the arm that answers again is taken for one whose hand may hold something.
    pub(crate) async fn come_back(&mut self) -> Result<(), End> {
        self.run.prepared = false;
        self.run.count_cut_short().await;
        self.run.clear_faults().await.map_err(super::Problem::end)?;
        self.go_home().await
    }

    /// What is in the hand.
    pub(crate) fn holding(&self) -> Holding {
        self.run.holding
    }

    /// Everything counted so far.
    pub(crate) fn tally(&self) -> &Tally {
        &self.run.tally
    }

    /// The arm is not led any more.
    pub(crate) async fn end(self, end: End) -> Report {
        self.run.end(end).await
    }
}
