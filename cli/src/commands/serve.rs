//! temp
/// Temp
#[derive(Debug, Clone, clap::Args)]
pub(crate) struct ServeArgs {}
pub(crate) fn run(_: &ServeArgs) -> anyhow::Result<()> { anyhow::bail!("temp") }
