//! `graspd bench`: how long each stage takes here, beside the published times.

mod cases;
mod curves;
mod published;
mod stats;

use std::io::Write as _;
use std::path::PathBuf;

use anyhow::Context as _;
use clap::Args;
use serde_json::{Map, Value, json};

use self::cases::Case;
use self::stats::Times;
use crate::output::table::Table;

/// Measures volume, estimation, refinement and optimization, and prints medians and 95th percentiles.
#[derive(Debug, Clone, Args)]
pub(crate) struct BenchArgs {
    /// Print one JSON object instead of a table: name → {median_ms, p95_ms, n}
    #[arg(long)]
    json: bool,
    /// Contact field to optimize in (NumPy archive), instead of that of the bundled frame
    #[arg(long, value_name = "NPZ")]
    contact_field: Option<PathBuf>,
    /// Only what has this in its name, for example optimize.leap; commas separate alternatives
    #[arg(long, default_value = "")]
    filter: String,
    /// Runs of each measurement
    #[arg(long, default_value_t = 15, value_parser = clap::value_parser!(u32).range(1..=10_000))]
    runs: u32,
    /// Draw how time grows with batch, iterations and focal contacts
    #[arg(long, value_name = "SVG")]
    curves: Option<PathBuf>,
}

/// Runs the benchmark.
///
/// # Errors
/// If the contact field cannot be read or nothing has the filter in its name.
pub(crate) fn run(args: &BenchArgs) -> anyhow::Result<()> {
    let bench = cases::Bench::new(args.contact_field.as_deref())?;
    let wanted = |name: &str| args.filter.split(',').any(|part| name.contains(part.trim()));
    let chosen: Vec<Case> = bench.cases().into_iter().filter(|case| wanted(&case.name)).collect();
    anyhow::ensure!(
        !chosen.is_empty(),
        "--filter: found {:?}, expected a part of a name such as optimize.leap",
        args.filter
    );
    let mut results: Vec<(String, Times)> = Vec::new();
    for case in &chosen {
        let times = stats::measure(args.runs as usize, || (case.run)(&bench));
        if !args.json {
            // Progress for people goes where it does not disturb a table in a file.
            writeln!(std::io::stderr(), "{:<28} {:>9.2} ms", case.name, times.median_ms).ok();
        }
        results.push((case.name.clone(), times));
    }
    if let Some(path) = &args.curves {
        let subtitle = format!(
            "median of {} runs, robotiq-3f, [200, 40], batch 48 where not varied, {} threads",
            args.runs,
            rayon::current_num_threads()
        );
        let svg = curves::svg(&results, &subtitle);
        let svg = svg.with_context(|| format!("--curves: found no scaling in {:?}", args.filter))?;
        std::fs::write(path, svg).with_context(|| format!("{}: cannot be written", path.display()))?;
    }
    let mut out = std::io::stdout().lock();
    if args.json {
        let object: Map<String, Value> = results
            .iter()
            .map(|(name, t)| {
                (name.clone(), json!({ "median_ms": t.median_ms, "p95_ms": t.p95_ms, "n": t.count }))
            })
            .collect();
        writeln!(out, "{}", Value::Object(object))?;
    } else {
        writeln!(out, "{}", table(&results, &bench))?;
    }
    Ok(())
}

fn table(results: &[(String, Times)], bench: &cases::Bench) -> String {
    let mut table = Table::new(
        &["name", "median ms", "p95 ms", "n", "target ms", "paper ms", "reference ms", "faster"],
        1,
    );
    for (name, t) in results {
        let (published, reference) = (published::time_ms(name), published::reference_ms(name));
        let fastest = published.into_iter().chain(reference).fold(f64::NAN, f64::min);
        table.row(vec![
            name.clone(),
            format!("{:.2}", t.median_ms),
            format!("{:.2}", t.p95_ms),
            t.count.to_string(),
            published::target_ms(name).map_or_else(String::new, |ms| format!("{ms:.0}")),
            published.map_or_else(String::new, |ms| format!("{ms:.0}")),
            reference.map_or_else(String::new, |ms| format!("{ms:.0}")),
            if fastest.is_nan() { String::new() } else { format!("{:.0}x", fastest / t.median_ms) },
        ]);
    }
    let memory = stats::peak_memory_mib().map_or_else(String::new, |mib| {
        format!(
            "peak memory of this process {mib:.0} MiB: all hands, scenes and measurements, not one plan\n"
        )
    });
    format!(
        "{table}\n{}\n{} threads\n{memory}paper: Supplementary Tables 1 and 2 (optimization alone), on an RTX 3060 Ti\n\
         reference: its published code on two cores of such a machine; faster: than the faster of the two",
        bench.describe(),
        rayon::current_num_threads(),
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_unique_and_hold_what_is_promised() {
        let bench = cases::Bench::new(None).unwrap();
        let names: Vec<String> = bench.cases().into_iter().map(|c| c.name).collect();
        let unique: std::collections::BTreeSet<&String> = names.iter().collect();
        assert_eq!(unique.len(), names.len());
        for name in [
            "volume.tsdf",
            "volume.occupancy",
            "volume.solid",
            "frame",
            "rank.robotiq-2f85",
            "rank.robotiq-3f",
            "rank.leap",
            "estimate.geometric",
            "refine",
            "optimize.leap",
            "optimize.antipodal.500x100",
            "plan.robotiq-3f",
            "plan.three-hands",
            "scaling.batch.96",
            "scaling.iterations.50",
        ] {
            assert!(unique.contains(&name.to_owned()), "{name} is missing from {names:?}");
        }
        assert!(names.iter().filter(|n| n.starts_with("scaling.focal-contacts.")).count() >= 3);
    }

    #[test]
    fn a_case_runs_and_takes_time() {
        let bench = cases::Bench::new(None).unwrap();
        let case = bench.cases().into_iter().find(|c| c.name == "refine").unwrap();
        let times = stats::measure(2, || (case.run)(&bench));
        assert!(times.median_ms > 0.0 && times.p95_ms >= times.median_ms);
        let text = table(&[("refine".into(), times)], &bench);
        assert!(text.contains("refine") && text.contains("15"), "{text}");
    }
}
