//! `graspd hands`: what hands there are, and whether a folder makes one.

mod init;

use std::io::Write as _;
use std::path::PathBuf;

use clap::{Args, Subcommand};
use graspd_hands::{CoordinateKind, Hand, JointKind, library};

use crate::hand_source;
use crate::output::table::Table;

/// Lists, shows and checks hands.
#[derive(Debug, Clone, Args)]
pub(crate) struct HandsArgs {
    #[command(subcommand)]
    action: Action,
}

#[derive(Debug, Clone, Subcommand)]
enum Action {
    /// List the hands that come with graspd
    List,
    /// Show a hand: joints, actuators, fingers, pads, opening
    Show {
        /// Id of a hand of the library, or its folder
        hand: String,
    },
    /// Check that a folder with hand.urdf and hand.toml makes a hand
    Check {
        /// The folder
        folder: PathBuf,
    },
    /// Start a description of a new hand from its URDF: writes a folder with hand.urdf and a proposed hand.toml
    Init {
        /// The URDF
        urdf: PathBuf,
        /// Folder to write; the URDF's name without its ending if left out
        #[arg(short, long)]
        out: Option<PathBuf>,
    },
}

/// Runs the command.
///
/// # Errors
/// For an unknown hand, a folder that makes none, and files that cannot be read or written.
pub(crate) fn run(args: &HandsArgs) -> anyhow::Result<()> {
    let mut out = std::io::stdout().lock();
    match &args.action {
        Action::List => write!(out, "{}", list())?,
        Action::Show { hand } => write!(out, "{}", show(&hand_source::resolve(hand)?))?,
        Action::Check { folder } => {
            anyhow::ensure!(
                folder.is_dir(),
                "{}: not a folder; expected one with hand.urdf and hand.toml",
                folder.display()
            );
            let files = graspd_server::read_hand_dir(folder)?;
            if let Some(warning) = hand_source::folder_warning(folder) {
                writeln!(out, "warning: {warning}")?;
            }
            let report = graspd_hands::check(&hand_source::id_of(folder), &files);
            writeln!(out, "{report}")?;
            let count = report.errors.len();
            let problems = if count == 1 { "problem" } else { "problems" };
            anyhow::ensure!(report.passed(), "{}: {count} {problems}", folder.display());
        }
        Action::Init { urdf, out: folder } => init::run(urdf, folder.as_deref(), &mut out)?,
    }
    Ok(())
}

fn millimetres(m: f64) -> String {
    format!("{:.1} mm", m * 1e3)
}

fn list() -> String {
    let header = ["id", "name", "fingers", "joints", "actuators", "pads", "candidates", "opens to", "reach"];
    let mut table = Table::new(&header, 2);
    for hand in library::ids().iter().filter_map(|id| library::hand(id)) {
        table.row(vec![
            hand.id.clone(),
            hand.display_name.clone(),
            hand.fingers.len().to_string(),
            hand.tree.joints.len().to_string(),
            hand.actuation.actuator_count().to_string(),
            hand.pads.len().to_string(),
            hand.candidates.len().to_string(),
            hand.opening.map_or_else(|| "-".to_owned(), |o| millimetres(o.max_m)),
            millimetres(hand.reach_m()),
        ]);
    }
    table.to_string()
}

fn show(hand: &Hand) -> String {
    let mut text = format!("{} ({}), revision {}\n", hand.display_name, hand.id, hand.revision);
    let v = |x: &nalgebra::Vector3<f64>| format!("({:.4}, {:.4}, {:.4})", x.x, x.y, x.z);
    text.push_str(&format!(
        "root link {}, approach {}, tool point {} m, reach {}\n",
        hand.tree.links.first().map_or("-", |l| l.name.as_str()),
        v(&hand.approach),
        v(&hand.tool_point.coords),
        millimetres(hand.reach_m()),
    ));
    if let Some(opening) = hand.opening {
        text.push_str(&format!(
            "opens from {} to {}\n",
            millimetres(opening.min_m),
            millimetres(opening.max_m)
        ));
    }
    let mut joints = Table::new(&["joint", "type", "lower", "upper", "effort"], 2);
    for j in &hand.tree.joints {
        let kind = match j.kind {
            JointKind::Revolute => "revolute, rad",
            JointKind::Prismatic => "prismatic, m",
        };
        let effort = if j.effort > 0.0 { format!("{:.2}", j.effort) } else { "-".into() };
        joints.row(vec![
            j.name.clone(),
            kind.into(),
            format!("{:.4}", j.lower),
            format!("{:.4}", j.upper),
            effort,
        ]);
    }
    let mut coordinates = Table::new(&["coordinate", "kind", "lower", "upper", "open", "closed"], 2);
    for c in &hand.actuation.coordinates {
        let kind = match c.kind {
            CoordinateKind::Actuator => "actuator",
            CoordinateKind::Adaptive => "adaptive",
        };
        let mut row = vec![c.name.clone(), kind.into()];
        row.extend([c.lower, c.upper, c.open, c.closed].map(|x| format!("{x:.4}")));
        coordinates.row(row);
    }
    let mut pads = Table::new(&["pad", "finger", "link", "size"], 3);
    for p in &hand.pads {
        pads.row(vec![
            p.name.clone(),
            hand.fingers.get(p.finger).map(|f| f.name.clone()).unwrap_or_default(),
            hand.tree.links.get(p.link).map(|l| l.name.clone()).unwrap_or_default(),
            format!("{:.1} x {:.1} mm", p.half_u.norm() * 2e3, p.half_v.norm() * 2e3),
        ]);
    }
    for table in [joints, coordinates, pads] {
        text.push_str(&format!("\n{table}"));
    }
    text.push_str(&format!(
        "\n{} contact candidates, {} collision shapes covered by {} spheres, {} pairs checked against each other\n",
        hand.candidates.len(),
        hand.collision.len(),
        hand.spheres.len(),
        hand.self_pairs.len()
    ));
    for warning in &hand.warnings {
        text.push_str(&format!("worth a look: {warning}\n"));
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_hand_of_the_library_is_listed_and_shown() {
        let list = list();
        assert_eq!(list.lines().count(), library::ids().len() + 1);
        for hand in library::ids().iter().filter_map(|id| library::hand(id)) {
            assert!(list.contains(&hand.id));
            let shown = show(hand);
            assert!(hand.tree.joints.iter().all(|j| shown.contains(&j.name)));
            assert!(hand.pads.iter().all(|p| shown.contains(&p.name)));
        }
    }
}
