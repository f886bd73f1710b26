//! The gripper without a line: frames in, frames out.

use std::time::{Duration, Instant};

use proptest::prelude::*;

use super::device::{Gripper, GripperConfig, Model};
use super::plant::KinematicPlant;
use super::rtu::{RtuSlave, check};
use super::socket::Talk;
use super::tcp::{ModbusTcp, Talker};
use crate::line::Reply;

/// Bytes as they are printed in manuals.
fn hex(text: &str) -> Vec<u8> {
    text.split_whitespace().map(|b| u8::from_str_radix(b, 16).unwrap()).collect()
}

fn two_finger() -> Gripper {
    let config = GripperConfig { takes: Duration::ZERO, ..GripperConfig::new(Model::TwoFinger) };
    Gripper::new(config, KinematicPlant::two_finger())
}

fn ask(slave: &mut RtuSlave, frame: &str, now: Instant) -> String {
    let answers = Talker::receive(slave, &hex(frame), now);
    let [answer] = &answers[..] else { panic!("{} answers", answers.len()) };
    answer.bytes.iter().map(|b| format!("{b:02X}")).collect::<Vec<_>>().join(" ")
}

#[test]
fn published_frames_have_the_published_answers() {
    let mut slave = RtuSlave::new(two_finger());
    let start = Instant::now();
    assert_eq!(check(&hex("09 03 07 D0 00 01")), [0x85, 0xCF]);
    let written = "09 10 03 E8 00 03 01 30";
    assert_eq!(ask(&mut slave, "09 10 03 E8 00 03 06 00 00 00 00 00 00 73 30", start), written);
    assert_eq!(ask(&mut slave, "09 10 03 E8 00 03 06 01 00 00 00 00 00 72 E1", start), written);
    assert_eq!(ask(&mut slave, "09 03 07 D0 00 01 85 CF", start), "09 03 02 11 00 55 D5");
    let mut now = start + Duration::from_millis(2500);
    assert_eq!(ask(&mut slave, "09 03 07 D0 00 01 85 CF", now), "09 03 02 31 00 4C 15");
    // Close at full speed, looked at on the way, then with an object.
    assert_eq!(ask(&mut slave, "09 10 03 E8 00 03 06 09 00 00 FF FF FF 42 29", now), written);
    now += Duration::from_millis(20);
    let moving = ask(&mut slave, "09 03 07 D0 00 03 04 0E", now);
    assert!(moving.starts_with("09 03 06 39 00 00 FF 0B 0A"), "{moving}");
    assert_eq!(ask(&mut slave, "09 03 0B B8 00 01 07 43", now), "09 83 02 41 33");
}

#[test]
fn an_object_is_felt_and_its_loss_too() {
    let plant = KinematicPlant::two_finger();
    let objects = plant.objects();
    let gripper =
        Gripper::new(GripperConfig { takes: Duration::ZERO, ..GripperConfig::new(Model::TwoFinger) }, plant);
    let mut slave = RtuSlave::new(gripper);
    let mut now = Instant::now();
    ask(&mut slave, "09 10 03 E8 00 03 06 01 00 00 00 00 00 72 E1", now);
    now += Duration::from_secs(3);
    // Nobody talked for a while: said once.
    assert_eq!(ask(&mut slave, "09 03 07 D0 00 03 04 0E", now)[..17], *"09 03 06 31 00 09");
    objects.between(0, Some(189.0));
    ask(&mut slave, "09 10 03 E8 00 03 06 09 00 00 FF FF FF 42 29", now);
    now += Duration::from_millis(900);
    assert_eq!(ask(&mut slave, "09 03 07 D0 00 03 04 0E", now)[..26], *"09 03 06 B9 00 00 FF BD 41");
    objects.between(0, None);
    now += Duration::from_millis(900);
    assert_eq!(ask(&mut slave, "09 04 07 D0 00 03 B1 CE", now)[..23], *"09 04 06 F9 00 00 FF E6");
}

#[test]
fn reads_and_writes_in_one_request_and_in_parts() {
    let gripper = two_finger();
    let mut slave = RtuSlave::new(gripper.clone());
    let mut now = Instant::now();
    ask(&mut slave, "09 10 03 E8 00 03 06 01 00 00 00 00 00 72 E1", now);
    now += Duration::from_secs(3);
    let answer = ask(&mut slave, "09 17 07 D0 00 03 03 E8 00 03 06 09 00 00 FF FF FF E6 3E", now);
    assert!(answer.starts_with("09 17 06 39 00"), "{answer}");
    // Position, speed and force alone: the action stays.
    let answer = ask(&mut slave, "09 17 07 D0 00 03 03 E9 00 02 04 00 C8 FF FF 0D E6", now);
    assert!(answer.starts_with("09 17 06 39 00 00 C8"), "{answer}");
    assert_eq!(gripper.request()[..6], [9, 0, 0, 0xC8, 0xFF, 0xFF]);
}

#[test]
fn a_request_counts_only_when_it_is_taken() {
    let gripper = Gripper::new(GripperConfig::new(Model::TwoFinger), KinematicPlant::two_finger());
    let now = Instant::now();
    let mut machine = gripper.lock();
    machine.write(0, &[1, 0, 0, 0, 0, 0], now);
    let now = now + Duration::from_secs(4);
    machine.write(0, &[9, 0, 0, 0, 255, 255], now);
    let now = now + Duration::from_secs(1);
    assert_eq!((machine.inputs(now)[0] >> 6, machine.inputs(now)[3]), (3, 0));
    machine.write(3, &[200], now);
    // Old news: at the request before.
    assert_eq!((machine.inputs(now)[0] >> 6, machine.inputs(now)[3]), (3, 0));
    let now = now + Duration::from_millis(30);
    assert_eq!((machine.inputs(now)[0] >> 6, machine.inputs(now)[3]), (0, 200));
}

#[test]
fn faults_follow_what_is_done_wrong() {
    let gripper = two_finger();
    let mut machine = gripper.lock();
    let mut now = Instant::now();
    let mut do_and_look = |machine: &mut super::gripper::Machine, action: u8, after_ms: u64| {
        machine.write(0, &[action], now);
        now += Duration::from_millis(after_ms);
        machine.inputs(now);
        machine.inputs(now)
    };
    assert_eq!(do_and_look(&mut machine, 0x08, 10)[2], 7, "go without activation");
    assert_eq!(do_and_look(&mut machine, 0x09, 10)[2], 5, "go before the activation is done");
    assert_eq!(do_and_look(&mut machine, 0x09, 3000)[2], 0);
    assert_eq!(do_and_look(&mut machine, 0x11, 100)[2], 0x0B, "automatic release");
    assert_eq!(do_and_look(&mut machine, 0x11, 9000)[2], 0x0F, "released");
    assert_eq!(do_and_look(&mut machine, 0x01, 100)[0] >> 4 & 3, 0, "only a new activation helps");
    assert_eq!(do_and_look(&mut machine, 0x00, 10)[2], 0);
    assert_eq!(do_and_look(&mut machine, 0x01, 3000)[..3], [0x31, 0, 0]);
    machine.set_fault(0x0E);
    assert_eq!(do_and_look(&mut machine, 0x09, 10)[2], 0x0E);
}

#[test]
fn three_fingers_have_modes_and_move_one_by_one() {
    let plant = KinematicPlant::three_finger();
    let objects = plant.objects();
    let config = GripperConfig { takes: Duration::ZERO, ..GripperConfig::new(Model::ThreeFinger) };
    let gripper = Gripper::new(config, plant);
    let mut machine = gripper.lock();
    let mut now = Instant::now();
    machine.write(0, &[1], now);
    now += Duration::from_secs(6);
    let status = machine.inputs(now);
    assert_eq!(status[0], 0x31, "{status:?}");
    // Pinch: the mode changes first.
    machine.write(0, &[0b1011], now);
    now += Duration::from_millis(100);
    let status = machine.inputs(now);
    assert_eq!((status[0] >> 4 & 3, status[0] >> 1 & 3, status[2]), (2, 1, 6), "{status:?}");
    now += Duration::from_secs(5);
    let status = machine.inputs(now);
    assert_eq!((status[0] >> 4, status[13]), (0b1111, 220), "{status:?}");
    // Each finger and the scissor alone; finger B meets something.
    objects.between(1, Some(80.0));
    machine.write(0, &[0b1001, 0b1100, 0, 50, 255, 255, 120, 255, 255, 70, 255, 255, 30, 255, 255], now);
    now += Duration::from_secs(4);
    let status = machine.inputs(now);
    assert_eq!([status[4], status[7], status[10], status[13]], [50, 80, 70, 30], "{status:?}");
    assert_eq!((status[0] >> 6, status[1]), (1, 0b11_11_10_11), "{status:?}");
}

#[test]
fn the_wrist_socket_speaks_lines() {
    let gripper = two_finger();
    let mut talk = Talk::new(gripper.clone());
    let mut now = Instant::now();
    let mut say = |text: &str, now: Instant| {
        let answers = talk.receive(text.as_bytes(), now);
        answers.into_iter().map(|a| String::from_utf8(a.bytes).unwrap()).collect::<Vec<_>>()
    };
    assert_eq!(say("SET ACT 1\n", now), ["ack"]);
    now += Duration::from_secs(3);
    assert_eq!(say("GET ACT\nGET STA\nGE", now), ["ACT 1\n", "STA 3\n"]);
    assert_eq!(say("T FLT\n", now), ["FLT 0\n"]);
    assert_eq!(say("SET POS 100 SPE 255 FOR 50 GTO 1\n", now), ["ack"]);
    now += Duration::from_secs(1);
    assert_eq!(
        say("GET PRE\nGET POS\nGET OBJ\nGET FOR\n", now),
        ["PRE 100\n", "POS 100\n", "OBJ 3\n", "FOR 50\n"]
    );
    assert_eq!(say("GET XYZ\nSET POS 300\nSET POS\nhello\n", now), ["XYZ ?\n"]);
    gripper.out_of_reach(true);
    assert_eq!(say("GET POS\n", now), ["POS ?\n"]);
}

#[test]
fn modbus_tcp_also_counts_from_zero() {
    let bytes = |replies: Vec<Reply>| replies.into_iter().map(|r| r.bytes).collect::<Vec<_>>();
    let mut talk = ModbusTcp::new(two_finger());
    let now = Instant::now();
    let write = hex("00 01 00 00 00 0D 02 10 00 00 00 03 06 01 00 00 00 00 00");
    assert_eq!(bytes(talk.receive(&write, now)), [hex("00 01 00 00 00 06 02 10 00 00 00 03")]);
    let read = hex("00 02 00 00 00 06 02 04 00 00 00 01");
    assert_eq!(bytes(talk.receive(&read, now)), [hex("00 02 00 00 00 05 02 04 02 11 00")]);
    assert!(talk.receive(&hex("00 02 00 07 00 06 02 04 00 00 00 01"), now).is_empty());
}

proptest! {
    #[test]
    fn no_bytes_panic(bytes in proptest::collection::vec(any::<u8>(), 0..400)) {
        let gripper = two_finger();
        let now = Instant::now();
        Talker::receive(&mut RtuSlave::new(gripper.clone()), &bytes, now);
        ModbusTcp::new(gripper.clone()).receive(&bytes, now);
        Talk::new(gripper).receive(&bytes, now);
    }

    #[test]
    fn no_request_panics(function in prop_oneof![Just(3u8), Just(4), Just(6), Just(16), Just(23), any::<u8>()], rest in proptest::collection::vec(any::<u8>(), 0..40), near in 990u16..1010) {
        let now = Instant::now();
        for model in [Model::TwoFinger, Model::ThreeFinger] {
            let gripper = Gripper::new(GripperConfig::new(model), KinematicPlant::three_finger());
            let mut frame = vec![9, function];
            frame.extend(near.to_be_bytes());
            frame.extend(&rest);
            frame.extend(check(&frame));
            let mut slave = RtuSlave::new(gripper);
            for answer in Talker::receive(&mut slave, &frame, now) {
                prop_assert!(answer.bytes.len() <= 256);
            }
            Talker::receive(&mut slave, &frame, now + Duration::from_secs(2));
        }
    }
}
