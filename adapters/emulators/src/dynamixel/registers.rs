//! Which registers may be written when, and what they hold at power-up.

use graspd_adapters_dynamixel::table::{self, Register};

/// Registers that only the motor writes.
const READ_ONLY: [Register; 16] = [
    table::MODEL_NUMBER,
    Register { addr: 2, len: 4, name: "Model Information" },
    table::FIRMWARE,
    table::REGISTERED,
    table::HARDWARE_ERROR,
    table::REALTIME_TICK,
    table::MOVING,
    table::MOVING_STATUS,
    table::PRESENT_PWM,
    table::PRESENT_CURRENT,
    table::PRESENT_VELOCITY,
    table::PRESENT_POSITION,
    table::VELOCITY_TRAJECTORY,
    table::POSITION_TRAJECTORY,
    table::PRESENT_VOLTAGE,
    table::PRESENT_TEMPERATURE,
];

/// Goals, which the bus watchdog locks when it fires.
const GOALS: [Register; 4] =
    [table::GOAL_PWM, table::GOAL_CURRENT, table::GOAL_VELOCITY, table::GOAL_POSITION];

fn touches(register: &Register, addr: u16, len: usize) -> bool {
    let (from, to) = (usize::from(addr), usize::from(addr) + len);
    let (first, end) = (usize::from(register.addr), usize::from(register.addr + register.len));
    from < end && first < to
}

pub(super) fn read_only(addr: u16, len: usize) -> bool {
    READ_ONLY.iter().any(|r| touches(r, addr, len))
}

pub(super) fn goal(addr: u16, len: usize) -> bool {
    GOALS.iter().any(|r| touches(r, addr, len))
}

/// Range of values that a register takes; signed registers are given as signed.
pub(super) fn range(register: Register) -> Option<(i64, i64)> {
    Some(match register {
        table::ID => (0, 252),
        table::BAUD_RATE => (0, 6),
        table::RETURN_DELAY => (0, 254),
        table::OPERATING_MODE => (0, 16),
        table::TEMPERATURE_LIMIT => (0, 100),
        table::TORQUE_ENABLE | table::LED => (0, 1),
        table::STATUS_RETURN_LEVEL => (0, 2),
        table::BUS_WATCHDOG => (0, 127),
        table::POSITION_P | table::POSITION_I | table::POSITION_D => (0, 16_383),
        _ => return None,
    })
}

/// Initial values that differ from zero, of one model: register and value.
pub(super) fn initial(id: u8, model: u16, return_delay: u8) -> Vec<(Register, i64)> {
    let full = model == table::XC330_M288;
    let pick = |lite: i64, xc: i64| if full { xc } else { lite };
    vec![
        (table::MODEL_NUMBER, i64::from(model)),
        (table::FIRMWARE, 50),
        (table::ID, i64::from(id)),
        (table::BAUD_RATE, 6),
        (table::RETURN_DELAY, i64::from(return_delay)),
        (table::OPERATING_MODE, 3),
        (table::TEMPERATURE_LIMIT, 70),
        (table::MAX_VOLTAGE, 70),
        (table::MIN_VOLTAGE, 35),
        (table::PWM_LIMIT, 885),
        (table::CURRENT_LIMIT, pick(1750, 2352)),
        (table::VELOCITY_LIMIT, pick(445, 350)),
        (table::MAX_POSITION, 4095),
        (table::SHUTDOWN, pick(53, 52)),
        (table::STATUS_RETURN_LEVEL, 2),
        (table::VELOCITY_I, 1600),
        (table::VELOCITY_P, pick(180, 50)),
        (table::POSITION_D, pick(0, 500)),
        (table::POSITION_P, pick(400, 1100)),
        (table::GOAL_PWM, 885),
        (table::GOAL_CURRENT, pick(1750, 2352)),
    ]
}
