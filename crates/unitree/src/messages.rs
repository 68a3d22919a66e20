//! Messages of a G1, field by field in the order of the wire.

use crate::cdr::{Message, c_layout, parts};

/// Entries for motors in `LowCmd` and `LowState`; a G1 has the first 29.
pub const MOTOR_SLOTS: usize = 35;

parts! {
    /// A motor's target: effort = tau + kp (q - measured) + kd (dq - measured), N m.
    #[derive(Copy, Default)]
    MotorCmd {
        /// 1 enables the motor, 0 disables it.
        mode: u8,
        /// rad.
        q: f32,
        /// rad/s.
        dq: f32,
        /// N m.
        tau: f32,
        /// N m/rad.
        kp: f32,
        /// N m s/rad.
        kd: f32,
        /// 0.
        reserve: u32,
    }

    /// All motors of the body.
    LowCmd {
        /// 0: targets of pitch and roll joints. 1: of the parallel linkages' motors.
        mode_pr: u8,
        /// As in `LowState`.
        mode_machine: u8,
        /// In the order of [`MOTORS`](crate::MOTORS).
        motor_cmd: [MotorCmd; MOTOR_SLOTS],
        /// 0.
        reserve: [u32; 4],
        /// See [`LowCmd::checksum`].
        crc: u32,
    }

    /// An inertial unit.
    #[derive(Copy, Default)]
    ImuState {
        /// w, x, y, z: its orientation in the world.
        quaternion: [f32; 4],
        /// rad/s, own frame.
        gyroscope: [f32; 3],
        /// Specific force, m/s^2, own frame: +9.81 along z at rest.
        accelerometer: [f32; 3],
        /// Roll, pitch, yaw, rad.
        rpy: [f32; 3],
        /// Degrees Celsius.
        temperature: i16,
    }

    /// A motor as measured.
    #[derive(Copy, Default)]
    MotorState {
        mode: u8,
        /// rad.
        q: f32,
        /// rad/s.
        dq: f32,
        /// rad/s^2.
        ddq: f32,
        /// N m.
        tau_est: f32,
        /// Of casing and winding, degrees Celsius.
        temperature: [i16; 2],
        /// V.
        vol: f32,
        sensor: [u32; 2],
        motorstate: u32,
        reserve: [u32; 4],
    }

    /// The robot as measured.
    LowState {
        version: [u32; 2],
        mode_pr: u8,
        /// Which G1 it is: 5 has 29 joints.
        mode_machine: u8,
        /// ms.
        tick: u32,
        imu_state: ImuState,
        motor_state: [MotorState; MOTOR_SLOTS],
        /// See [`Remote`](crate::Remote).
        wireless_remote: [u8; 40],
        reserve: [u32; 4],
        crc: u32,
    }

    /// A motor's target of a hand.
    #[derive(Copy, Default)]
    HandMotorCmd {
        mode: u8,
        /// 0 closed, 1 open.
        q: f32,
        dq: f32,
        tau: f32,
        kp: f32,
        kd: f32,
        reserve: [u32; 3],
    }

    /// Both hands.
    HandCmds {
        cmds: Vec<HandMotorCmd>,
    }

    /// Who asks for what.
    #[derive(Copy, Default)]
    RequestIdentity {
        id: i64,
        api_id: i64,
    }

    /// Header of a request.
    #[derive(Copy, Default)]
    RequestHeader {
        identity: RequestIdentity,
        lease_id: i64,
        priority: i32,
        noreply: bool,
    }

    /// A call of one of the robot's services.
    Request {
        header: RequestHeader,
        /// JSON.
        parameter: String,
        binary: Vec<u8>,
    }

    /// Header of a response.
    #[derive(Copy, Default)]
    ResponseHeader {
        identity: RequestIdentity,
        /// 0: done.
        status: i32,
    }

    /// A service's answer.
    Response {
        header: ResponseHeader,
        /// JSON.
        data: String,
        binary: Vec<u8>,
    }
}

impl Message for LowCmd {
    const TYPE: &'static str = "unitree_hg::msg::dds_::LowCmd_";
}

impl Message for LowState {
    const TYPE: &'static str = "unitree_hg::msg::dds_::LowState_";
}

impl Message for HandCmds {
    const TYPE: &'static str = "unitree_go::msg::dds_::MotorCmds_";
}

impl Message for Request {
    const TYPE: &'static str = "unitree_api::msg::dds_::Request_";
}

impl Message for Response {
    const TYPE: &'static str = "unitree_api::msg::dds_::Response_";
}

impl Default for LowCmd {
    fn default() -> Self {
        Self { mode_pr: 0, mode_machine: 0, motor_cmd: [MotorCmd::default(); MOTOR_SLOTS], reserve: [0; 4], crc: 0 }
    }
}

impl Default for LowState {
    fn default() -> Self {
        Self {
            version: [0; 2],
            mode_pr: 0,
            mode_machine: 0,
            tick: 0,
            imu_state: ImuState::default(),
            motor_state: [MotorState::default(); MOTOR_SLOTS],
            wireless_remote: [0; 40],
            reserve: [0; 4],
            crc: 0,
        }
    }
}

impl LowCmd {
    /// Its checksum as the robot computes it, whatever `crc` says.
    pub fn checksum(&self) -> u32 {
        checksum(&c_layout(self))
    }

    /// The same with its checksum.
    pub fn sealed(mut self) -> Self {
        self.crc = self.checksum();
        self
    }
}

impl LowState {
    /// Its checksum, whatever `crc` says.
    pub fn checksum(&self) -> u32 {
        checksum(&c_layout(self))
    }

    /// The same with its checksum.
    pub fn sealed(mut self) -> Self {
        self.crc = self.checksum();
        self
    }
}

/// CRC-32 with the polynomial 0x04C11DB7, from all ones, each word's highest bit first, without reflection and without a last exclusive
/// or, over all words of a C struct but the last, which is the checksum itself.
fn checksum(layout: &[u8]) -> u32 {
    let words = layout.chunks_exact(4).map(|word| u32::from_le_bytes([word[0], word[1], word[2], word[3]]));
    words.take(layout.len() / 4 - 1).fold(u32::MAX, |crc, word| {
        (0..32).rev().fold(crc, |crc, bit| {
            let feeds = (crc >> 31) ^ (word >> bit & 1);
            (crc << 1) ^ (feeds * 0x04C1_1DB7)
        })
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn hex(bytes: &[u8]) -> String {
        bytes.iter().map(|byte| format!("{byte:02x}")).collect()
    }

    fn modes(kd: f32) -> LowCmd {
        let mut cmd = LowCmd { mode_machine: 5, ..LowCmd::default() };
        cmd.motor_cmd = [MotorCmd { mode: 1, kd, ..MotorCmd::default() }; MOTOR_SLOTS];
        cmd
    }

    fn ramp() -> LowCmd {
        let mut cmd = LowCmd { mode_machine: 5, ..LowCmd::default() };
        for (index, motor) in cmd.motor_cmd[..29].iter_mut().enumerate() {
            *motor = MotorCmd { mode: 1, q: (0.1 * index as f64) as f32, kp: 40.0, kd: 1.0, ..MotorCmd::default() };
        }
        cmd
    }

    // Computed with Unitree's Python SDK 1.0 and CycloneDDS 11.0.1, which made the bytes of its own samples.
    #[test]
    fn checksums_are_those_of_the_makers_library() {
        assert_eq!(LowCmd::default().checksum(), 0xfe17_2f9f);
        assert_eq!(modes(0.0).checksum(), 0x7717_6f39);
        assert_eq!(modes(8.0).checksum(), 0xd7e3_ab3a);
        assert_eq!(ramp().checksum(), 0x2d82_bc79);
        let mut state = LowState { mode_machine: 5, tick: 1234, ..LowState::default() };
        state.imu_state.quaternion[0] = 1.0;
        state.imu_state.accelerometer[2] = 9.81;
        state.imu_state.temperature = 30;
        for (index, motor) in state.motor_state.iter_mut().enumerate() {
            *motor =
                MotorState { mode: 1, q: (0.01 * index as f64) as f32, temperature: [40, 50], ..MotorState::default() };
        }
        assert_eq!(state.checksum(), 0xf2ce_84b8);
    }

    #[test]
    fn bytes_are_those_of_cyclone() {
        let bytes = ramp().sealed().to_cdr();
        assert_eq!(bytes.len(), 1004);
        let start = "000100000005010000000000000000000000000000002042\
                     0000803f0000000001000000cdcccc3d";
        assert!(hex(&bytes).starts_with(start), "{}", hex(&bytes[..48]));
        assert!(hex(&bytes).ends_with("0000000079bc822d"));
        assert_eq!(LowState::default().to_cdr().len(), 2092);
        assert_eq!(HandCmds { cmds: vec![HandMotorCmd::default(); 12] }.to_cdr().len(), 440);
        assert_eq!(LowCmd::from_cdr(&bytes), Ok(ramp().sealed()));
    }

    #[test]
    fn a_sample_that_is_cut_or_foreign_is_refused() {
        use crate::cdr::CdrError;
        let whole = ramp().to_cdr();
        for length in 0..whole.len() {
            assert!(LowCmd::from_cdr(&whole[..length]).is_err(), "{length} bytes");
        }
        let padded = [whole.as_slice(), &[0; 3]].concat();
        assert!(LowCmd::from_cdr(&padded).is_ok());
        assert_eq!(LowCmd::from_cdr(&[whole.as_slice(), &[0; 4]].concat()), Err(CdrError::Long { rest: 4 }));
        let mut xcdr2 = whole;
        xcdr2[1] = 7;
        assert_eq!(LowCmd::from_cdr(&xcdr2), Err(CdrError::Encapsulation([0, 7])));
        // A list that says it has four billion entries, and one that has fewer than it says.
        assert_eq!(
            HandCmds::from_cdr(&[0, 1, 0, 0, 255, 255, 255, 255]),
            Err(CdrError::List { length: u32::MAX as usize })
        );
        assert!(HandCmds::from_cdr(&[0, 1, 0, 0, 2, 0, 0, 0, 1]).is_err());
    }

    #[test]
    fn texts_end_with_a_zero() {
        let request = Request { header: RequestHeader::default(), parameter: "{}".into(), binary: vec![1, 2] };
        let bytes = request.to_cdr();
        assert_eq!(Request::from_cdr(&bytes), Ok(request));
        // The length of the text stands after two ids, lease, priority and the flag: at 32, of the header's 4 bytes at 36.
        assert_eq!(bytes[36..44], [3, 0, 0, 0, b'{', b'}', 0, 0]);
    }
}
