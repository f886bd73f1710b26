//! `graspd lease`: who has a thing that several cells or arms want.

use std::io::Write as _;
use std::time::Duration;

use anyhow::Context as _;
use clap::{Args, Subcommand};
use graspd_engine_nats::{Lease, Leases, Node};

use super::engine::EngineArgs;

/// Takes, keeps and gives back things that several cells or arms want, for example a bin. Ends with 1 where somebody
/// else has it.
#[derive(Debug, Clone, Args)]
pub(crate) struct LeaseArgs {
    #[command(flatten)]
    engine: EngineArgs,
    #[command(subcommand)]
    what: What,
}

#[derive(Debug, Clone, Subcommand)]
enum What {
    /// Takes a thing that nobody has; prints the lease's number
    Take {
        /// The thing
        thing: String,
        /// Who takes it
        #[arg(long)]
        holder: String,
        /// Seconds until somebody else may take it, unless it is renewed
        #[arg(long, value_name = "SECONDS", default_value_t = 10.0)]
        lasts: f64,
    },
    /// Keeps a lease for longer; prints its new number
    Renew {
        /// The thing
        thing: String,
        /// Who has it
        #[arg(long)]
        holder: String,
        /// The number that the lease has
        #[arg(long)]
        token: u64,
        /// Seconds from now
        #[arg(long, value_name = "SECONDS", default_value_t = 10.0)]
        lasts: f64,
    },
    /// Gives a lease back
    Give {
        /// The thing
        thing: String,
        /// The number that the lease has
        #[arg(long)]
        token: u64,
    },
    /// Prints all leases: thing, holder, number, seconds left
    List,
}

fn seconds(value: f64) -> anyhow::Result<Duration> {
    anyhow::ensure!((0.001..=86_400.0).contains(&value), "--lasts: found {value}, expected 0.001 to 86400");
    Ok(Duration::from_secs_f64(value))
}

/// Runs the command.
///
/// # Errors
/// If the lease cannot be had, or the broker cannot be reached.
pub(crate) fn run(args: &LeaseArgs) -> anyhow::Result<()> {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    runtime.block_on(async {
        let broker = args.engine.connect(Node::Visitor).await?;
        let broker = broker.context("--engine: found nothing, expected the address of a NATS broker")?;
        let leases = Leases::open(&broker).await?;
        let known = |thing: &str, holder: &str, token| Lease {
            thing: thing.to_owned(),
            holder: holder.to_owned(),
            token,
            left: Duration::ZERO,
        };
        let mut out = std::io::stdout();
        match &args.what {
            What::Take { thing, holder, lasts } => {
                writeln!(out, "{}", leases.take(thing, holder, seconds(*lasts)?).await?.token)?;
            }
            What::Renew { thing, holder, token, lasts } => {
                let lease = leases.renew(&known(thing, holder, *token), seconds(*lasts)?).await?;
                writeln!(out, "{}", lease.token)?;
            }
            What::Give { thing, token } => leases.give(&known(thing, "", *token)).await?,
            What::List => {
                for lease in leases.list().await? {
                    let left = lease.left.as_secs_f64();
                    writeln!(out, "{}\t{}\t{}\t{left:.1}", lease.thing, lease.holder, lease.token)?;
                }
            }
        }
        Ok(())
    })
}
