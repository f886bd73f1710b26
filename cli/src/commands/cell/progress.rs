//! What a person sees of a run: a live table on a terminal, plain lines elsewhere. On standard error, which holds no
//! results.

use std::io::{IsTerminal as _, Write as _};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use graspd_cell::config::CellConfig;
use graspd_cell::observer::{Event, Observer};
use graspd_cell::outcome::Outcome;
use graspd_cell::record::AttemptRecord;
use graspd_cell::report::Tally;
use indicatif::{ProgressBar, ProgressStyle};

/// Watches a run.
pub(super) struct Progress {
    /// The live table; `None` where nobody watches a terminal.
    bar: Option<ProgressBar>,
    stop: Arc<AtomicBool>,
    hand: String,
    attempt: u32,
    step: String,
    tally: Tally,
    trouble: String,
}

impl Progress {
    pub(super) fn new(config: &CellConfig, stop: Arc<AtomicBool>) -> Self {
        let bar = std::io::stderr().is_terminal().then(|| {
            let bar = ProgressBar::new_spinner();
            if let Ok(style) = ProgressStyle::with_template("{spinner} {elapsed_precise}  {msg}") {
                bar.set_style(style);
            }
            bar.enable_steady_tick(Duration::from_millis(100));
            bar
        });
        Self {
            bar,
            stop,
            hand: config.hand.id.clone(),
            attempt: 1,
            step: String::new(),
            tally: Tally::default(),
            trouble: String::new(),
        }
    }

    /// Takes the live table away.
    pub(super) fn end(&self) {
        if let Some(bar) = &self.bar {
            bar.finish_and_clear();
        }
    }

    fn table(&self) -> String {
        let t = &self.tally;
        let rate = t.rate().map_or_else(|| "-".to_owned(), |r| format!("{:.1} %", 100.0 * r));
        let plan = t.plan_s.last().map_or_else(|| "-".to_owned(), |s| format!("{:.0} ms", 1000.0 * s));
        let left = t.in_tray.map_or_else(|| "?".to_owned(), |n| n.to_string());
        let mut text = format!(
            "{}  attempt {}  {}\n  successes {} of {} trials  rate {rate}  left in the tray {left}  last plan {plan}",
            self.hand, self.attempt, self.step, t.successes, t.trials
        );
        for (name, line) in [("last failure", t.last_failure.as_ref()), ("trouble", Some(&self.trouble))] {
            if let Some(line) = line.filter(|l| !l.is_empty()) {
                text.push_str(&format!("\n  {name}: {line}"));
            }
        }
        text
    }

    fn line(&self, text: &str) {
        match &self.bar {
            Some(bar) => bar.println(text),
            // Standard error may be closed.
            None => drop(writeln!(std::io::stderr(), "{text}")),
        }
    }
}

/// One line for an attempt that ended.
fn attempt_line(record: &AttemptRecord, tally: &Tally) -> String {
    let result = match &record.outcome {
        Outcome::Success => "success".to_owned(),
        Outcome::Failed { class, why } => format!("failed ({}): {why}", class.name()),
        Outcome::NotExecuted { why } => format!("nothing executed: {why}"),
        Outcome::Unknown { why } => format!("unknown: {why}"),
    };
    let plan =
        record.answer.as_ref().map_or_else(String::new, |a| format!("plan {:4.0} ms  ", 1000.0 * a.plan_s));
    let score = record.chosen.as_ref().map_or_else(String::new, |c| format!("score {:.2}  ", c.grasp.score));
    let out = match record.out_of_reach.len() {
        0 => String::new(),
        out => format!("  ({out} grasps out of reach)"),
    };
    let rate =
        tally.rate().map_or_else(String::new, |r| format!("  [{:.0} % of {}]", 100.0 * r, tally.trials));
    format!("attempt {:3}  {plan}{score}{result}{out}{rate}", record.attempt)
}

impl Observer for Progress {
    fn on(&mut self, event: &Event<'_>) {
        match event {
            Event::StepBegan { attempt, step } => {
                self.attempt = *attempt;
                self.step = step.to_string();
            }
            Event::Trouble { step, trouble, text, recovery, .. } => {
                self.trouble = format!("{step}: {text}; {}", recovery.text());
                if self.bar.is_none() {
                    self.line(&format!("  {step}: {} ({text}): {}", trouble.name(), recovery.text()));
                }
            }
            Event::AttemptEnded { record, tally } => {
                self.line(&attempt_line(record, tally));
                self.tally = (*tally).clone();
                self.trouble.clear();
            }
            Event::StepEnded { .. } | Event::Ended(_) => {}
        }
        if let Some(bar) = &self.bar {
            bar.set_message(self.table());
        }
    }

    fn wants_end(&self) -> bool {
        self.stop.load(Ordering::Relaxed)
    }
}
