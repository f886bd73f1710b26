//! `graspd completions` and `graspd man`: the command line as shells and the manual know it.

use std::io::Write as _;
use std::path::PathBuf;

use anyhow::Context as _;
use clap::{Args, Command};
use clap_complete::Shell;

/// Writes a completion script for a shell to standard output.
#[derive(Debug, Clone, Args)]
pub(crate) struct CompletionsArgs {
    /// The shell
    #[arg(value_enum)]
    shell: Shell,
}

/// Writes the manual page: that of graspd to standard output, or one for each command into a folder.
#[derive(Debug, Clone, Args)]
pub(crate) struct ManArgs {
    /// Folder for graspd.1, graspd-serve.1 and so on
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
}

/// Writes a completion script.
///
/// # Errors
/// If standard output cannot be written.
pub(crate) fn completions(args: &CompletionsArgs, mut command: Command) -> anyhow::Result<()> {
    // The generator panics where its output cannot be written: memory always can.
    let mut script = Vec::new();
    clap_complete::generate(args.shell, &mut command, "graspd", &mut script);
    std::io::stdout().lock().write_all(&script)?;
    Ok(())
}

/// Writes manual pages.
///
/// # Errors
/// If the folder or standard output cannot be written.
pub(crate) fn man(args: &ManArgs, command: Command) -> anyhow::Result<()> {
    match &args.out {
        Some(folder) => {
            let at = || format!("{}: cannot be written", folder.display());
            std::fs::create_dir_all(folder).with_context(at)?;
            clap_mangen::generate_to(command, folder).with_context(at)
        }
        None => {
            let mut page = Vec::new();
            clap_mangen::Man::new(command).render(&mut page)?;
            std::io::stdout().lock().write_all(&page)?;
            Ok(())
        }
    }
}
