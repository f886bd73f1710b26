//! temp
pub(crate) fn run(_: &std::path::Path, _: Option<&std::path::Path>, _: &mut impl std::io::Write) -> anyhow::Result<()> { anyhow::bail!("temp") }
