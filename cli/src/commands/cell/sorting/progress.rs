//! What a person sees of a sorting run: the table of who does what, live on a terminal, lines elsewhere.

use std::io::{IsTerminal as _, Write as _};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use graspd_cell::sort::table::{Doing, SortEvent, SortObserver, Table};
use indicatif::{ProgressBar, ProgressStyle};

/// Watches a run.
pub(super) struct Progress {
    bar: Option<ProgressBar>,
    stop: Arc<AtomicBool>,
    quiet: bool,
    last: Vec<String>,
    trouble: String,
}

impl Progress {
    pub(super) fn new(stop: Arc<AtomicBool>, quiet: bool) -> Self {
        let bar = (!quiet && std::io::stderr().is_terminal()).then(|| {
            let bar = ProgressBar::new_spinner();
            if let Ok(style) = ProgressStyle::with_template("{spinner} {elapsed_precise}\n{msg}") {
                bar.set_style(style);
            }
            bar.enable_steady_tick(Duration::from_millis(100));
            bar
        });
        Self { bar, stop, quiet, last: Vec::new(), trouble: String::new() }
    }

    /// Takes the live table away.
    pub(super) fn end(&self) {
        if let Some(bar) = &self.bar {
            bar.finish_and_clear();
        }
    }

    fn line(&self, text: &str) {
        match &self.bar {
            Some(bar) => bar.println(text),
            None if self.quiet => {}
            // Nobody may be reading.
            None => drop(writeln!(std::io::stderr(), "{text}")),
        }
    }

    fn table(&mut self, table: &Table) {
        if let Some(bar) = &self.bar {
            bar.set_message(format!("{table}{}", self.trouble));
            return;
        }
        // Without a terminal: a line when somebody does something else.
        self.last.resize(table.rows.len(), String::new());
        let mut lines = Vec::new();
        for (row, last) in table.rows.iter().zip(&mut self.last) {
            let now = match &row.doing {
                Doing::Picking { object, bin, .. } => format!("takes object {object} to {bin}"),
                other => other.to_string(),
            };
            if now != *last {
                lines.push(format!("{:6.1} s  {:<12} {now}", table.time_s, row.arm));
                *last = now;
            }
        }
        for line in lines {
            self.line(&line);
        }
    }
}

impl SortObserver for Progress {
    fn on(&mut self, event: &SortEvent<'_>) {
        match event {
            SortEvent::Table(table) => self.table(table),
            SortEvent::Decided(records) => {
                for record in records.iter().filter(|r| r.given.is_some()) {
                    let Some(given) = &record.given else { continue };
                    let [score, size, reach] = given.factors;
                    self.line(&format!(
                        "{:6.1} s  {:<12} is given object {} ({:.0} mm, {}): {:.2} = score {score:.2} × size {size:.2} × reach \
                         {reach:.2}; {}",
                        record.time_s,
                        record.arm,
                        given.object,
                        1e3 * given.width_m,
                        given.rule,
                        given.value,
                        record.reason
                    ));
                }
            }
            SortEvent::Trouble { arm, text } => {
                self.trouble = format!("{}: {text}", arm.unwrap_or("cell"));
                let line = self.trouble.clone();
                self.line(&line);
            }
        }
    }

    fn wants_end(&self) -> bool {
        self.stop.load(Ordering::Relaxed)
    }
}
