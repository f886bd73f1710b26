//! temp
/// Temp
#[derive(Debug, Clone, clap::Args)]
pub(crate) struct DemoArgs {}
pub(crate) fn run(_: &DemoArgs) -> anyhow::Result<()> { anyhow::bail!("temp") }
