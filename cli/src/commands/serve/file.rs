//! The settings file of `graspd serve`: TOML, every key optional, unknown keys and wrong values refused by name.

use std::net::SocketAddr;
use std::path::PathBuf;
use std::time::Duration;

use anyhow::{Context as _, ensure};
use graspd_server::pool::Priority;
use graspd_server::security::{Certificate, Role, Tls, Token};
use graspd_server::{LiveConfig, RecordConfig, ServerConfig};
use serde::Deserialize;

#[derive(Debug, Default, Deserialize)]
#[serde(deny_unknown_fields)]
struct File {
    listen: Option<SocketAddr>,
    insecure_listen: Option<bool>,
    metrics_listen: Option<SocketAddr>,
    page: Option<bool>,
    hands_dir: Option<PathBuf>,
    calibration: Option<PathBuf>,
    otlp: Option<String>,
    drain_seconds: Option<f64>,
    #[serde(default)]
    planning: Planning,
    tls: Option<TlsTable>,
    record: Option<RecordTable>,
    live: Option<LiveTable>,
    #[serde(default)]
    limits: LimitsTable,
    #[serde(default)]
    token: Vec<Entry>,
    #[serde(default)]
    certificate: Vec<Entry>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(deny_unknown_fields)]
struct Planning {
    threads: Option<u32>,
    slots: Option<u32>,
    servo_slots: Option<u32>,
    queue: Option<u32>,
    nice: Option<u32>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct RecordTable {
    folder: PathBuf,
    share: Option<f64>,
    budget_mib: Option<u32>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct LiveTable {
    listen: SocketAddr,
    #[serde(default)]
    origins: Vec<String>,
    clients: Option<u32>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct TlsTable {
    certificate: PathBuf,
    key: PathBuf,
    client_roots: Option<PathBuf>,
    require_client_certificate: Option<bool>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(deny_unknown_fields)]
struct LimitsTable {
    message_mib: Option<u32>,
    connections: Option<u32>,
    connections_per_address: Option<u32>,
    handshake_seconds: Option<f64>,
    receive_seconds: Option<f64>,
    header_kib: Option<u32>,
    calls_per_caller: Option<u32>,
    mib_per_caller: Option<u32>,
    uploads_per_minute: Option<u32>,
    servo_streams: Option<u32>,
    servo_idle_seconds: Option<f64>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Entry {
    name: String,
    sha256: String,
    role: String,
    most_urgent: Option<String>,
}

/// Reads the settings, and whether the page is shown, where the file says so.
///
/// # Errors
/// Naming the key, what was found and what was expected.
pub(super) fn parse(text: &str) -> anyhow::Result<(ServerConfig, Option<bool>)> {
    let file: File = toml::from_str(text)?;
    let mut config = ServerConfig::default();
    if let Some(listen) = file.listen {
        config.listen = listen;
    }
    config.insecure_listen = file.insecure_listen.unwrap_or(false);
    config.metrics_listen = file.metrics_listen;
    config.hands_dir = file.hands_dir;
    config.otlp = file.otlp;
    config.calibration = file.calibration.as_deref().map(super::calibration).transpose()?;
    if let Some(given) = file.drain_seconds {
        config.drain_grace = seconds("drain_seconds", given, 0.0)?;
    }
    let pool = &mut config.pool;
    set(&mut pool.threads, "planning.threads", file.planning.threads, (1, 1024))?;
    set(&mut pool.slots, "planning.slots", file.planning.slots, (1, 1024))?;
    set(&mut pool.servo_slots, "planning.servo_slots", file.planning.servo_slots, (0, 1024))?;
    set(&mut pool.queue, "planning.queue", file.planning.queue, (0, 100_000))?;
    let mut nice = usize::from(pool.nice);
    set(&mut nice, "planning.nice", file.planning.nice, (0, 19))?;
    pool.nice = u8::try_from(nice).unwrap_or(19);
    config.tls = file.tls.map(|tls| Tls {
        require_client_certificate: tls.require_client_certificate.unwrap_or(tls.client_roots.is_some()),
        certificate: tls.certificate,
        key: tls.key,
        client_roots: tls.client_roots,
    });
    if let Some(tls) = &config.tls {
        ensure!(
            tls.client_roots.is_some() || !tls.require_client_certificate,
            "tls.require_client_certificate: found true, expected tls.client_roots with it"
        );
    }
    config.record = file.record.map(record).transpose()?;
    config.live = file.live.map(live).transpose()?;
    limits(&mut config, &file.limits)?;
    let entry = |kind: &str, i: usize, entry: &Entry| -> anyhow::Result<(Role, [u8; 32], Option<Priority>)> {
        let at = |key: &str| format!("{kind}[{i}].{key} ({:?})", entry.name);
        let role = Role::by_name(&entry.role).with_context(|| {
            format!("{}: found {:?}, expected viewer, controller or operator", at("role"), entry.role)
        })?;
        let sha256 = hash(&entry.sha256).with_context(|| {
            format!("{}: found {} characters, expected 64 of 0-9a-f", at("sha256"), entry.sha256.len())
        })?;
        let most_urgent = entry.most_urgent.as_deref().map(|given| {
            Priority::ALL.into_iter().find(|p| p.name() == given).with_context(|| {
                format!("{}: found {given:?}, expected low, normal, high or servo", at("most_urgent"))
            })
        });
        Ok((role, sha256, most_urgent.transpose()?))
    };
    for (i, given) in file.token.into_iter().enumerate() {
        let (role, sha256, most_urgent) = entry("token", i, &given)?;
        config.access.most_urgent.extend(most_urgent.map(|p| (given.name.clone(), p)));
        config.access.tokens.push(Token { name: given.name, sha256, role });
    }
    for (i, given) in file.certificate.into_iter().enumerate() {
        let (role, sha256, most_urgent) = entry("certificate", i, &given)?;
        config.access.most_urgent.extend(most_urgent.map(|p| (given.name.clone(), p)));
        config.access.certificates.push(Certificate { name: given.name, sha256, role });
    }
    config.access.check()?;
    Ok((config, file.page))
}

fn record(file: RecordTable) -> anyhow::Result<RecordConfig> {
    let mut record = super::record_in(file.folder);
    if let Some(share) = file.share {
        ensure!((0.0..=1.0).contains(&share), "record.share: found {share}, expected 0 to 1");
        record.share = share;
    }
    let mut mib = usize::try_from(record.budget_bytes >> 20).unwrap_or(usize::MAX);
    set(&mut mib, "record.budget_mib", file.budget_mib, (16, u32::MAX))?;
    record.budget_bytes = (mib as u64) << 20;
    Ok(record)
}

fn live(file: LiveTable) -> anyhow::Result<LiveConfig> {
    let mut live = LiveConfig { origins: file.origins, ..LiveConfig::at(file.listen) };
    set(&mut live.clients, "live.clients", file.clients, (1, 1000))?;
    Ok(live)
}

fn limits(config: &mut ServerConfig, file: &LimitsTable) -> anyhow::Result<()> {
    let limits = &mut config.limits;
    set(&mut limits.connections, "limits.connections", file.connections, (1, 1_000_000))?;
    set(
        &mut limits.connections_per_address,
        "limits.connections_per_address",
        file.connections_per_address,
        (1, 1_000_000),
    )?;
    set(&mut limits.calls_per_caller, "limits.calls_per_caller", file.calls_per_caller, (1, 1_000_000))?;
    set(&mut limits.uploads_per_minute, "limits.uploads_per_minute", file.uploads_per_minute, (0, 100_000))?;
    set(&mut limits.servo_streams, "limits.servo_streams", file.servo_streams, (0, 10_000))?;
    if let Some(given) = file.servo_idle_seconds {
        limits.servo_idle = seconds("limits.servo_idle_seconds", given, 0.01)?;
    }
    let (mut message_mib, mut mib, mut kib) = (16, 512, 16);
    set(&mut message_mib, "limits.message_mib", file.message_mib, (1, 1024))?;
    set(&mut mib, "limits.mib_per_caller", file.mib_per_caller, (1, 1 << 20))?;
    set(&mut kib, "limits.header_kib", file.header_kib, (1, 1024))?;
    config.max_message_bytes = message_mib << 20;
    limits.bytes_per_caller = (mib as u64) << 20;
    limits.header_bytes = u32::try_from(kib << 10).unwrap_or(u32::MAX);
    if let Some(given) = file.handshake_seconds {
        limits.handshake = seconds("limits.handshake_seconds", given, 0.01)?;
    }
    if let Some(given) = file.receive_seconds {
        limits.receive = seconds("limits.receive_seconds", given, 0.01)?;
    }
    Ok(())
}

fn set(slot: &mut usize, key: &str, value: Option<u32>, (low, high): (u32, u32)) -> anyhow::Result<()> {
    if let Some(value) = value {
        ensure!((low..=high).contains(&value), "{key}: found {value}, expected {low} to {high}");
        *slot = value as usize;
    }
    Ok(())
}

fn seconds(key: &str, value: f64, least: f64) -> anyhow::Result<Duration> {
    ensure!((least..=86_400.0).contains(&value), "{key}: found {value}, expected {least} to 86400 seconds");
    Ok(Duration::from_secs_f64(value))
}

/// 64 hexadecimal digits.
fn hash(text: &str) -> Option<[u8; 32]> {
    let mut bytes = [0; 32];
    if text.len() != 64 || !text.is_ascii() {
        return None;
    }
    for (i, byte) in bytes.iter_mut().enumerate() {
        *byte = u8::from_str_radix(text.get(2 * i..2 * i + 2)?, 16).ok()?;
    }
    Some(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The example of the operations guide.
    const EXAMPLE: &str = include_str!("../../../../deploy/graspd.toml");

    #[test]
    fn the_example_is_read_and_nothing_is_the_default() {
        let (config, page) = parse(EXAMPLE).unwrap();
        assert_eq!(page, None);
        assert_eq!((config.pool.queue, config.access.tokens.len()), (32, 2));
        assert!(config.tls.unwrap().client_roots.is_none());
        let (nothing, _) = parse("").unwrap();
        assert_eq!(parse("page = false").unwrap().1, Some(false));
        let default = ServerConfig::default();
        assert_eq!((nothing.limits, nothing.pool), (default.limits, default.pool));
        assert_eq!((nothing.listen, nothing.max_message_bytes), (default.listen, default.max_message_bytes));
    }

    #[test]
    fn wrong_values_are_named() {
        let hash = "0".repeat(63);
        let cases = [
            ("lisen = \"127.0.0.1:1\"".to_owned(), "unknown field `lisen`"),
            ("listen = \"here\"".to_owned(), "line 1, column 10"),
            ("[planning]\nslots = 0".to_owned(), "planning.slots: found 0, expected 1 to 1024"),
            ("[planning]\nslots = -1".to_owned(), "line 2, column 9"),
            ("[planning]\nnice = 20".to_owned(), "planning.nice: found 20, expected 0 to 19"),
            ("[limits]\nreceive_seconds = 0".to_owned(), "limits.receive_seconds: found 0, expected 0.01 to"),
            ("[record]\nfolder = \"r\"\nshare = 2".to_owned(), "record.share: found 2, expected 0 to 1"),
            ("[record]\nshare = 1".to_owned(), "missing field `folder`"),
            (
                "[record]\nfolder = \"r\"\nbudget_mib = 1".to_owned(),
                "record.budget_mib: found 1, expected 16",
            ),
            ("[live]\nlisten = \"127.0.0.1:0\"\nclients = 0".to_owned(), "live.clients: found 0, expected 1"),
            ("[live]\norigins = []".to_owned(), "missing field `listen`"),
            ("drain_seconds = nan".to_owned(), "drain_seconds: found NaN"),
            (
                format!("[[token]]\nname = \"arm\"\nrole = \"controller\"\nsha256 = \"{hash}\""),
                "token[0].sha256 (\"arm\"): found 63 characters, expected 64",
            ),
            (
                format!("[[token]]\nname = \"arm\"\nrole = \"king\"\nsha256 = \"{hash}0\""),
                "token[0].role (\"arm\"): found \"king\", expected viewer, controller or operator",
            ),
            (
                format!(
                    "[[token]]\nname = \"arm\"\nrole = \"viewer\"\nsha256 = \"{hash}1\"\nmost_urgent = \"x\""
                ),
                "token[0].most_urgent (\"arm\"): found \"x\", expected low, normal",
            ),
            (
                "[tls]\ncertificate = \"a\"\nkey = \"b\"\nrequire_client_certificate = true".to_owned(),
                "tls.require_client_certificate: found true, expected tls.client_roots",
            ),
        ];
        for (text, expected) in cases {
            let error = format!("{:#}", parse(&text).unwrap_err());
            assert!(error.contains(expected), "{text:?}: {error}");
        }
    }
}
