//! Tests of the load generator: due times, mixes, refusals, and a run against a server in this process.

use clap::Parser;
use graspd_client::Code;
use graspd_server::{Server, ServerConfig};

use super::call::{End, Outcome};
use super::mix::Draw;
use super::report::Report;
use super::*;

#[derive(Debug, Parser)]
struct Only {
    #[command(flatten)]
    load: LoadArgs,
}

fn parse(flags: &str) -> Result<LoadArgs, String> {
    let only = Only::try_parse_from(std::iter::once("load").chain(flags.split_whitespace()));
    only.map(|o| o.load).map_err(|e| e.to_string())
}

fn arrivals(from: f64, to: f64, spacing: Spacing) -> Vec<f64> {
    let over = Duration::from_secs(100);
    Arrivals { from, to, over, spacing, seed: 3 }.due_times().map(|d| d.as_secs_f64()).collect()
}

#[test]
fn due_times_have_the_rate_and_the_spacing_that_was_asked_for() {
    let constant = arrivals(10.0, 10.0, Spacing::Constant);
    assert!((999..=1000).contains(&constant.len()), "{}", constant.len());
    assert!(constant.windows(2).all(|w| (w[1] - w[0] - 0.1).abs() < 1e-6));
    let poisson = arrivals(10.0, 10.0, Spacing::Poisson);
    assert!((900..1100).contains(&poisson.len()), "{}", poisson.len());
    assert!(poisson.is_sorted());
    // Gaps of exponential length: about one in e is longer than the mean.
    let long = poisson.windows(2).filter(|w| w[1] - w[0] > 0.1).count() as f64 / poisson.len() as f64;
    assert!((0.33..0.41).contains(&long), "{long}");
    assert_eq!(poisson, arrivals(10.0, 10.0, Spacing::Poisson));
    for (from, to) in [(1.0, 19.0), (19.0, 1.0)] {
        let ramp = arrivals(from, to, Spacing::Constant);
        assert!((995..=1000).contains(&ramp.len()), "{}", ramp.len());
        let first_half = ramp.iter().filter(|t| **t < 50.0).count() as f64;
        let expected = 50.0 * (from + (from + to) / 2.0) / 2.0;
        assert!((first_half - expected).abs() < 3.0, "{first_half}, expected {expected}");
    }
}

#[test]
fn a_mix_is_drawn_by_weight() {
    let mix: Mix = "a=3, b".parse().unwrap();
    let picked = (0..4000).filter(|n| mix.pick(Draw::of(1, *n, 0)) == 0).count();
    assert!((2880..3120).contains(&picked), "{picked}");
    for wrong in ["", "a=", "a=0", "a=-1", "=2", "a=nan", "a,,b"] {
        assert!(wrong.parse::<Mix>().is_err(), "{wrong:?}");
    }
    let objective: Objective = "p99=250ms".parse().unwrap();
    assert_eq!((objective.quantile, objective.limit), (0.99, Duration::from_millis(250)));
    for wrong in ["p99", "p0=1ms", "p100=1ms", "99=1ms", "p99=1s", "p99=0ms"] {
        assert!(wrong.parse::<Objective>().is_err(), "{wrong:?}");
    }
}

#[test]
fn others_are_not_attacked_and_wrong_flags_are_named() {
    for own in ["http://127.0.0.1:1", "http://localhost:50051/", "http://[::1]:80", "127.0.0.1:9"] {
        refuse_others(own).unwrap();
    }
    for other in ["http://192.0.2.1:50051", "http://0.0.0.0:1", "http://[2001:db8::1]:1", "http://192.0.2.1"]
    {
        let error = refuse_others(other).unwrap_err().to_string();
        assert!(error.contains("--i-own-this-target"), "{error}");
    }
    parse("--servo 1").unwrap().check().unwrap();
    let message = |flags: &str| parse(flags).unwrap().check().unwrap_err().to_string();
    assert!(message("").contains("--rate, --concurrency and --find-max"));
    assert!(message("--rate=-1").starts_with("--rate: found -1"));
    assert!(message("--rate 1 --drop 2").starts_with("--drop: found 2"));
    assert!(message("--rate 1 --servo 1 --servo-rate 0").starts_with("--servo-rate: found 0"));
    assert!(message("--rate 1 --duration 0").starts_with("--duration: found 0"));
    assert!(message("--rate 1 --server http://192.0.2.1:1").contains("not this machine"));
    assert!(parse("--rate 1 --concurrency 2").is_err());
    parse("--rate 1 --server http://192.0.2.1:1 --i-own-this-target").unwrap().check().unwrap();
}

#[test]
fn load_on_a_server_of_our_own_is_counted_to_the_last_call() {
    let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build().unwrap();
    runtime.block_on(async {
        let config = ServerConfig { listen: ([127, 0, 0, 1], 0).into(), ..ServerConfig::default() };
        let server = Server::bind(config).await.unwrap();
        let address = server.local_addr();
        tokio::spawn(server.serve_until(std::future::pending()));
        let common = format!(
            "--server http://{address} --deadline-ms 20000 --warmup 0 --duration 1 --batch 4 --scheme 5,5 \
             --sizes 80x60,160x120 --priorities low,high --hands antipodal,panda --stream 0.5"
        );
        let open = parse(&format!("{common} --rate 12 --drop 0.3 --arrivals constant")).unwrap();
        let report = open.measure().await.unwrap();
        assert!((11..=12).contains(&report.calls()), "{}", report.calls());
        let json = report.to_json();
        let codes: u64 = json["codes"].as_object().unwrap().values().filter_map(|v| v.as_u64()).sum();
        assert_eq!(codes + json["dropped"].as_u64().unwrap(), report.calls());
        assert!(json["codes"]["OK"].as_u64().unwrap() > 0, "{json}");
        assert!(json["iterations"]["5"].as_u64().unwrap() > 0, "{json}");
        assert!(report.to_text().contains("offered 12.0/s"));
        let closed =
            parse(&format!("{common} --concurrency 2 --same-frame")).unwrap().measure().await.unwrap();
        assert!(closed.calls() > 0 && closed.answered_share() > 0.99, "{}", closed.to_text());
        let servo = parse(&format!("{common} --concurrency 1 --servo 2 --servo-rate 5")).unwrap();
        let json = servo.measure().await.unwrap().to_json();
        let both = json["servo"].as_array().unwrap();
        assert_eq!(both.len(), 2, "each stream has figures of its own: {json}");
        for servo in both {
            let (frames, answered) = (servo["frames"].as_u64().unwrap(), &servo["answered"]["count"]);
            assert!(servo["broken"].as_object().unwrap().is_empty(), "{json}");
            assert!((1..=frames).contains(&answered.as_u64().unwrap()), "{json}");
            assert!(servo["gaps"]["count"].as_u64().unwrap() < answered.as_u64().unwrap(), "{json}");
        }
        let alone = parse(&format!("{common} --servo 1 --servo-rate 5")).unwrap().measure().await.unwrap();
        assert_eq!(alone.calls(), 0);
        assert!(alone.to_text().contains("servo streams alone"), "{}", alone.to_text());
        let nobody = parse("--rate 1 --hands nobody --server http://127.0.0.1:1").unwrap();
        assert!(nobody.measure().await.is_err());
    });
}

/// Whoever sees a code wants to know why.
#[test]
fn the_first_message_of_each_code_is_told() {
    let args = parse("--rate 1").unwrap();
    let mut report = Report::new(&args, 1.0).unwrap();
    for (reason, message) in [("QUEUE_FULL", "first"), ("QUEUE_FULL", "second"), ("", "no reason")] {
        let end =
            End::Failed { code: Code::ResourceExhausted, reason: reason.into(), message: message.into() };
        let (latency, service) = (Duration::from_millis(3), Duration::from_millis(2));
        report.count(&Outcome { latency, service, end, priority: 0, in_time: false });
    }
    let json = report.to_json();
    let expected =
        serde_json::json!({"ResourceExhausted": "no reason", "ResourceExhausted/QUEUE_FULL": "first"});
    assert_eq!(json["messages"], expected);
    let text = report.to_text();
    assert!(text.contains("first") && text.contains("no reason") && !text.contains("second"), "{text}");
}
