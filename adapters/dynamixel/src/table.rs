//! Control table of the X330 series (XL330-M288, XC330-M288): the same registers, other initial values.

/// A register: where it is and how long, bytes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct Register {
    /// First address.
    pub addr: u16,
    /// Bytes.
    pub len: u16,
    /// Name in the manual.
    pub name: &'static str,
}

macro_rules! registers {
    ($($(#[$doc:meta])* $constant:ident = $addr:literal, $len:literal, $name:literal;)*) => {
        $($(#[$doc])* pub const $constant: Register = Register { addr: $addr, len: $len, name: $name };)*
        /// Every register that is named here, by address.
        pub const ALL: &[Register] = &[$($constant),*];
    };
}

registers! {
    /// Model number; read-only.
    MODEL_NUMBER = 0, 2, "Model Number";
    /// Firmware; read-only.
    FIRMWARE = 6, 1, "Firmware Version";
    /// Address on the bus.
    ID = 7, 1, "ID";
    /// Baud rate, by number: 6 is 4 Mbps.
    BAUD_RATE = 8, 1, "Baud Rate";
    /// Delay before an answer, 2 microseconds each.
    RETURN_DELAY = 9, 1, "Return Delay Time";
    /// Bit 0: turns the other way.
    DRIVE_MODE = 10, 1, "Drive Mode";
    /// 0 current, 1 velocity, 3 position, 4 extended position, 5 current-based position, 16 PWM.
    OPERATING_MODE = 11, 1, "Operating Mode";
    /// Added to the position, pulses.
    HOMING_OFFSET = 20, 4, "Homing Offset";
    /// Shuts down above, degrees Celsius.
    TEMPERATURE_LIMIT = 31, 1, "Temperature Limit";
    /// Shuts down above, 0.1 V.
    MAX_VOLTAGE = 32, 2, "Max Voltage Limit";
    /// Shuts down below, 0.1 V.
    MIN_VOLTAGE = 34, 2, "Min Voltage Limit";
    /// Largest PWM.
    PWM_LIMIT = 36, 2, "PWM Limit";
    /// Largest current, 1 mA.
    CURRENT_LIMIT = 38, 2, "Current Limit";
    /// Largest speed, 0.229 rpm.
    VELOCITY_LIMIT = 44, 4, "Velocity Limit";
    /// Largest position, pulses.
    MAX_POSITION = 48, 4, "Max Position Limit";
    /// Smallest position, pulses.
    MIN_POSITION = 52, 4, "Min Position Limit";
    /// Which hardware errors switch torque off; bits as in [`HARDWARE_ERROR`].
    SHUTDOWN = 63, 1, "Shutdown";
    /// 1: holds and moves.
    TORQUE_ENABLE = 64, 1, "Torque Enable";
    /// LED.
    LED = 65, 1, "LED";
    /// Who is answered: 0 ping, 1 also read, 2 everything.
    STATUS_RETURN_LEVEL = 68, 1, "Status Return Level";
    /// A staged write waits.
    REGISTERED = 69, 1, "Registered Instruction";
    /// Bits: 0 voltage, 2 overheating, 3 encoder, 4 electrical shock, 5 overload. Cleared by a reboot only.
    HARDWARE_ERROR = 70, 1, "Hardware Error Status";
    /// Integral gain of the speed.
    VELOCITY_I = 76, 2, "Velocity I Gain";
    /// Proportional gain of the speed.
    VELOCITY_P = 78, 2, "Velocity P Gain";
    /// Derivative gain of the position.
    POSITION_D = 80, 2, "Position D Gain";
    /// Integral gain of the position.
    POSITION_I = 82, 2, "Position I Gain";
    /// Proportional gain of the position.
    POSITION_P = 84, 2, "Position P Gain";
    /// Feed-forward of the acceleration.
    FEEDFORWARD_2 = 88, 2, "Feedforward 2nd Gain";
    /// Feed-forward of the speed.
    FEEDFORWARD_1 = 90, 2, "Feedforward 1st Gain";
    /// Stops after this silence, 20 ms each; 0 never. 255: it has, and goals are locked until 0 is written.
    BUS_WATCHDOG = 98, 1, "Bus Watchdog";
    /// PWM to use at most.
    GOAL_PWM = 100, 2, "Goal PWM";
    /// Current to use at most, in mode 5; 1 mA.
    GOAL_CURRENT = 102, 2, "Goal Current";
    /// Speed to go with.
    GOAL_VELOCITY = 104, 4, "Goal Velocity";
    /// Acceleration of its own path; 0: no limit.
    PROFILE_ACCELERATION = 108, 4, "Profile Acceleration";
    /// Speed of its own path; 0: no limit.
    PROFILE_VELOCITY = 112, 4, "Profile Velocity";
    /// Where to go, pulses.
    GOAL_POSITION = 116, 4, "Goal Position";
    /// Clock, milliseconds; read-only.
    REALTIME_TICK = 120, 2, "Realtime Tick";
    /// 1 while it moves; read-only.
    MOVING = 122, 1, "Moving";
    /// How it moves; read-only.
    MOVING_STATUS = 123, 1, "Moving Status";
    /// PWM; read-only.
    PRESENT_PWM = 124, 2, "Present PWM";
    /// Current, signed, 1 mA; read-only.
    PRESENT_CURRENT = 126, 2, "Present Current";
    /// Speed, signed, 0.229 rpm; read-only.
    PRESENT_VELOCITY = 128, 4, "Present Velocity";
    /// Position, signed, pulses of 2 pi / 4096; read-only.
    PRESENT_POSITION = 132, 4, "Present Position";
    /// Speed of its own path; read-only.
    VELOCITY_TRAJECTORY = 136, 4, "Velocity Trajectory";
    /// Position of its own path; read-only.
    POSITION_TRAJECTORY = 140, 4, "Position Trajectory";
    /// Voltage, 0.1 V; read-only.
    PRESENT_VOLTAGE = 144, 2, "Present Input Voltage";
    /// Temperature, degrees Celsius; read-only.
    PRESENT_TEMPERATURE = 146, 1, "Present Temperature";
}

/// First of twenty registers of two bytes that say what [`INDIRECT_DATA`] shows.
pub const INDIRECT_ADDRESS: u16 = 168;
/// First of twenty bytes that show other registers (the manual's address; some model files say 224).
pub const INDIRECT_DATA: u16 = 208;
/// Bytes of the whole table.
pub const TABLE_LEN: usize = 228;
/// First address of what is lost without power, and may be written while torque is on.
pub const RAM_START: u16 = 64;

/// Pulses of a turn.
pub const PULSES_PER_TURN: f64 = 4096.0;
/// Radians per second of one count of velocity (0.229 rpm).
pub const RAD_S_PER_COUNT: f64 = 0.229 * std::f64::consts::TAU / 60.0;
/// Current-based position control.
pub const MODE_CURRENT_POSITION: u8 = 5;

/// Model number of the XL330-M288.
pub const XL330_M288: u16 = 1200;
/// Model number of the XC330-M288.
pub const XC330_M288: u16 = 1240;

/// What the bits of [`HARDWARE_ERROR`] mean, lowest first.
pub const HARDWARE_ERRORS: [(u8, &str); 5] =
    [(0, "input voltage"), (2, "overheating"), (3, "encoder"), (4, "electrical shock"), (5, "overload")];

/// Names of the hardware errors in a byte; bits without a name by their number.
pub fn hardware_errors(byte: u8) -> Vec<String> {
    (0..8)
        .filter(|bit| byte & (1 << bit) != 0)
        .map(|bit| {
            let known = HARDWARE_ERRORS.iter().find(|(b, _)| *b == bit);
            known.map_or_else(|| format!("bit {bit}"), |(_, name)| (*name).to_owned())
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn registers_do_not_overlap_and_lie_in_the_table() {
        for pair in ALL.windows(2) {
            assert!(pair[0].addr + pair[0].len <= pair[1].addr, "{pair:?}");
        }
        assert!(ALL.iter().all(|r| usize::from(r.addr + r.len) <= TABLE_LEN));
        // What one sync read of ten bytes gets.
        assert_eq!((PRESENT_CURRENT.addr, PRESENT_POSITION.addr + PRESENT_POSITION.len), (126, 136));
    }

    #[test]
    fn hardware_errors_have_names() {
        assert_eq!(hardware_errors(0b10_0100), ["overheating", "overload"]);
        assert_eq!(hardware_errors(0b10), ["bit 1"]);
        assert!((RAD_S_PER_COUNT - 0.023_98).abs() < 1e-5);
    }
}
