//! Kinematics against a table that an independent implementation computed (ur-analytic-ik; the table says which).

use graspd_adapters_ur::kinematics::{Joints, Kinematics, Model};

const TABLE: &str = include_str!("golden/kinematics.tsv");

fn same_posture(a: &Joints, b: &[f64]) -> bool {
    a.iter().zip(b).all(|(a, b)| (a.sin() - b.sin()).abs() + (a.cos() - b.cos()).abs() < 1e-6)
}

#[test]
fn forward_and_every_branch_agree_with_an_independent_implementation() {
    let (mut postures, mut branches) = (0, 0);
    for line in TABLE.lines().filter(|line| !line.starts_with('#')) {
        let mut words = line.split('\t');
        let name = words.next().unwrap();
        let model = Model::ALL.into_iter().find(|m| m.name().eq_ignore_ascii_case(name)).unwrap();
        let numbers: Vec<f64> = words.map(|w| w.parse().unwrap()).collect();
        let joints: Joints = numbers[..6].try_into().unwrap();
        let arm = Kinematics::new(model);
        let pose = arm.forward(&joints);
        let matrix = pose.to_homogeneous();
        for (i, expected) in numbers[6..18].iter().enumerate() {
            assert!((matrix[(i / 4, i % 4)] - expected).abs() < 1e-10, "{line}: {matrix}");
        }
        let ours = arm.inverse(&pose, 0.0);
        let theirs = &numbers[18..];
        assert_eq!(ours.len(), theirs.len() / 6, "{line}");
        for branch in theirs.chunks(6) {
            assert!(
                ours.iter().any(|s| same_posture(&s.joints, branch)),
                "{line}: {branch:?} not in {ours:?}"
            );
            branches += 1;
        }
        postures += 1;
    }
    assert_eq!(postures, 56);
    assert!(branches > 250, "{branches}");
}
