//! The bus without a line: instructions in, answers out.

use std::time::{Duration, Instant};

use graspd_adapters_dynamixel::table::{self, Register};
use graspd_adapters_dynamixel::{BROADCAST, Decoder, Event, Instruction, Refusal, Status, fast_sync_blocks};
use proptest::prelude::*;

use super::bus::Bus;
use super::{BusConfig, KinematicPlant};

fn bus(start: Instant) -> Bus {
    let mut config = BusConfig::leap(true);
    config.motors.truncate(4);
    Bus::new(config, Box::new(KinematicPlant::new()), start)
}

fn ask(bus: &mut Bus, id: u8, instruction: Instruction, now: Instant) -> Vec<Status> {
    let bytes = instruction.to_packet(id).unwrap().encode().unwrap();
    let mut decoder = Decoder::new();
    bus.receive(&bytes, now).iter().for_each(|r| decoder.push(&r.bytes));
    decoder
        .map(|event| match event {
            Event::Packet(packet) => Status::from_packet(&packet).unwrap(),
            other => panic!("{other:?}"),
        })
        .collect()
}

fn write(bus: &mut Bus, id: u8, register: Register, value: i32, now: Instant) -> Option<Refusal> {
    let data = value.to_le_bytes()[..usize::from(register.len)].to_vec();
    let answers = ask(bus, id, Instruction::Write { addr: register.addr, data }, now);
    assert_eq!(answers.len(), 1);
    answers[0].error.refusal
}

#[test]
fn bytes_are_answered_with_the_published_bytes() {
    let start = Instant::now();
    let mut bus = bus(start);
    let torque_on = [0xFF, 0xFF, 0xFD, 0, 0, 6, 0, 3, 0x40, 0, 1, 0xC8, 0xE7];
    let replies = bus.receive(&torque_on, start);
    assert_eq!(replies[0].bytes, [0xFF, 0xFF, 0xFD, 0, 0, 4, 0, 0x55, 0, 0xDA, 0x8C]);
    // 13 bytes there, 500 microseconds of return delay, 11 bytes back, at 4 Mbps.
    assert_eq!(replies[0].after, Duration::from_nanos(500_000 + 24 * 2500));
    // The operating mode is locked now: access error.
    let mode = [0xFF, 0xFF, 0xFD, 0, 0, 6, 0, 3, 0x0B, 0, 5, 0x4F, 0x62];
    assert_eq!(bus.receive(&mode, start)[0].bytes, [0xFF, 0xFF, 0xFD, 0, 0, 4, 0, 0x55, 7, 0xCB, 0x0C]);
}

#[test]
fn registers_begin_as_published() {
    let start = Instant::now();
    let config = |full| BusConfig { return_delay: 250, ..BusConfig::leap(full) };
    // Address, bytes, values of an XL330-M288 and an XC330-M288.
    for (addr, len, lite, xc) in [
        (0, 2, 1200, 1240),
        (9, 1, 250, 250),
        (11, 1, 3, 3),
        (20, 4, 0, 0),
        (31, 1, 70, 70),
        (32, 2, 70, 70),
        (34, 2, 35, 35),
        (36, 2, 885, 885),
        (38, 2, 1750, 2352),
        (44, 4, 445, 350),
        (48, 4, 4095, 4095),
        (52, 4, 0, 0),
        (63, 1, 53, 52),
        (64, 1, 0, 0),
        (68, 1, 2, 2),
        (76, 2, 1600, 1600),
        (78, 2, 180, 50),
        (80, 2, 0, 500),
        (82, 2, 0, 0),
        (84, 2, 400, 1100),
        (88, 4, 0, 0),
        (98, 1, 0, 0),
        (108, 4, 0, 0),
        (112, 4, 0, 0),
        (168, 2, 208, 208),
        (206, 2, 227, 227),
    ] {
        for (full, expected) in [(false, lite), (true, xc)] {
            let mut bus = Bus::new(config(full), Box::new(KinematicPlant::new()), start);
            let bytes = bus.peek(5, addr, len, start).unwrap();
            let found = bytes.iter().rev().fold(0i64, |value, byte| value << 8 | i64::from(*byte));
            assert_eq!(found, expected, "address {addr}, full {full}");
        }
    }
}

#[test]
fn motors_go_where_they_are_told_and_obey_limits() {
    let start = Instant::now();
    let mut bus = bus(start);
    assert_eq!(write(&mut bus, 1, table::GOAL_POSITION, 4096, start), Some(Refusal::DataLimit));
    assert_eq!(write(&mut bus, 1, table::OPERATING_MODE, 5, start), None);
    assert_eq!(write(&mut bus, 1, table::GOAL_CURRENT, 2353, start), Some(Refusal::DataLimit));
    assert_eq!(write(&mut bus, 1, table::PRESENT_POSITION, 0, start), Some(Refusal::Access));
    assert_eq!(write(&mut bus, 1, table::TORQUE_ENABLE, 1, start), None);
    assert_eq!(write(&mut bus, 1, table::GOAL_POSITION, 2548, start), None);
    let later = start + Duration::from_secs(1);
    let answers = ask(&mut bus, 1, Instruction::Read { addr: 132, len: 4 }, later);
    assert_eq!(answers[0].data, 2548i32.to_le_bytes());
    assert_eq!(
        ask(&mut bus, 1, Instruction::Read { addr: 226, len: 4 }, later)[0].error.refusal,
        Some(Refusal::DataRange)
    );
    let staged = Instruction::RegWrite { addr: 116, data: 2000i32.to_le_bytes().to_vec() };
    assert_eq!(ask(&mut bus, 1, staged, later)[0].error.refusal, None);
    assert_eq!(ask(&mut bus, BROADCAST, Instruction::Action, later), []);
    let later = later + Duration::from_secs(1);
    assert_eq!(bus.peek(1, 132, 4, later).unwrap(), 2000i32.to_le_bytes());
}

#[test]
fn many_motors_answer_in_turn_or_together() {
    let start = Instant::now();
    let mut bus = bus(start);
    assert_eq!(ask(&mut bus, BROADCAST, Instruction::Ping, start).len(), 4);
    let ids = vec![2, 0, 3];
    let read = Instruction::SyncRead { addr: 126, len: 10, ids: ids.clone() };
    let order: Vec<u8> = ask(&mut bus, BROADCAST, read.clone(), start).iter().map(|s| s.id).collect();
    assert_eq!(order, ids);
    let fast = Instruction::FastSyncRead { addr: 126, len: 10, ids: ids.clone() };
    let bytes = fast.to_packet(BROADCAST).unwrap().encode().unwrap();
    let replies = bus.receive(&bytes, start);
    let mut decoder = Decoder::new();
    decoder.push(&replies[0].bytes);
    let Some(Event::Packet(packet)) = decoder.next_event() else { panic!("{replies:?}") };
    let blocks = fast_sync_blocks(&packet, 10).unwrap();
    assert_eq!(blocks.iter().map(|b| b.id).collect::<Vec<_>>(), ids);
    // What follows a missing motor does not come.
    bus.unplug(0, true);
    assert_eq!(ask(&mut bus, BROADCAST, read, start).len(), 1);
    let bulk = Instruction::BulkRead { blocks: vec![(1, 132, 4), (2, 146, 1)] };
    let lens: Vec<usize> = ask(&mut bus, BROADCAST, bulk, start).iter().map(|s| s.data.len()).collect();
    assert_eq!(lens, [4, 1]);
    bus.unplug(0, false);
    let goals = [(0, 116, 2100i32.to_le_bytes().to_vec()), (1, 65, vec![1])].to_vec();
    assert_eq!(ask(&mut bus, BROADCAST, Instruction::BulkWrite { blocks: goals }, start), []);
    assert_eq!(bus.peek(1, 65, 1, start).unwrap(), [1]);
}

#[test]
fn a_shut_down_motor_is_without_torque_until_it_reboots() {
    let start = Instant::now();
    let mut bus = bus(start);
    write(&mut bus, 2, table::TORQUE_ENABLE, 1, start);
    bus.raise(2, 0x20);
    let answer = &ask(&mut bus, 2, Instruction::Read { addr: 64, len: 7 }, start)[0];
    assert!(answer.error.alert && answer.data == [0, 0, 0, 0, 2, 0, 0x20]);
    assert_eq!(write(&mut bus, 2, table::TORQUE_ENABLE, 1, start), Some(Refusal::Result));
    assert_eq!(ask(&mut bus, 2, Instruction::Reboot, start).len(), 1);
    assert_eq!(ask(&mut bus, 2, Instruction::Ping, start + Duration::from_millis(100)), []);
    let later = start + Duration::from_millis(300);
    assert!(!ask(&mut bus, 2, Instruction::Ping, later)[0].error.alert);
    assert_eq!(write(&mut bus, 2, table::TORQUE_ENABLE, 1, later), None);
}

#[test]
fn the_bus_watchdog_stops_a_motor_and_locks_its_goals() {
    let start = Instant::now();
    let mut bus = bus(start);
    write(&mut bus, 0, table::TORQUE_ENABLE, 1, start);
    write(&mut bus, 0, table::PROFILE_VELOCITY, 42, start);
    write(&mut bus, 0, table::BUS_WATCHDOG, 5, start);
    write(&mut bus, 0, table::GOAL_POSITION, 4000, start);
    let silent = start + Duration::from_millis(300);
    assert_eq!(write(&mut bus, 0, table::GOAL_POSITION, 4000, silent), Some(Refusal::DataRange));
    assert_eq!(bus.peek(0, 98, 1, silent).unwrap(), [255]);
    // 100 ms at about 1 rad/s: it stopped on its way, 300 ms after the last word.
    let stopped = i32::from_le_bytes(bus.peek(0, 132, 4, silent).unwrap().try_into().unwrap());
    assert!((stopped - 2048 - 65).abs() <= 2, "{stopped}");
    assert_eq!(write(&mut bus, 0, table::BUS_WATCHDOG, 0, silent), None);
    assert_eq!(write(&mut bus, 0, table::GOAL_POSITION, 3000, silent), None);
}

#[test]
fn indirect_data_shows_other_registers() {
    let start = Instant::now();
    let mut bus = bus(start);
    let address = Register { addr: table::INDIRECT_ADDRESS, len: 2, name: "Indirect Address 1" };
    let initial = ask(&mut bus, 0, Instruction::Read { addr: address.addr, len: 2 }, start)[0].data.clone();
    assert_eq!(initial, table::INDIRECT_DATA.to_le_bytes());
    assert_eq!(write(&mut bus, 0, address, 146, start), None);
    assert_eq!(ask(&mut bus, 0, Instruction::Read { addr: 208, len: 1 }, start)[0].data, [30]);
}

proptest! {
    #[test]
    fn no_bytes_panic(bytes in proptest::collection::vec(any::<u8>(), 0..200)) {
        bus(Instant::now()).receive(&bytes, Instant::now());
    }

    #[test]
    fn no_instruction_panics(code in any::<u8>(), id in prop_oneof![0u8..4, Just(BROADCAST)], params in proptest::collection::vec(any::<u8>(), 0..40)) {
        let packet = graspd_adapters_dynamixel::Packet { id, instruction: code, params };
        let mut bus = bus(Instant::now());
        bus.receive(&packet.encode().unwrap(), Instant::now());
        bus.receive(&packet.encode().unwrap(), Instant::now() + Duration::from_secs(1));
    }
}
