//! Laws that hold whatever happens in whatever order: random schedules against an independent book-keeper.

use std::collections::BTreeMap;
use std::time::Duration;

use proptest::collection::vec;
use proptest::prelude::*;

use super::*;

/// Something that happens.
#[derive(Debug, Clone)]
enum Step {
    Admit {
        priority: usize,
        caller: u64,
        hand: u64,
        deadline_ms: Option<u64>,
        least_ms: u64,
        more_ms: u64,
    },
    Continue {
        priority: usize,
        caller: u64,
    },
    Take,
    /// A take in which jobs with this payload's parity cannot begin.
    TakeSome(u64),
    End(usize),
    Withdraw(usize),
    Wait(u64),
    Expire,
}

fn step() -> impl Strategy<Value = Step> {
    let deadline = prop::option::weighted(0.8, 1u64..2000);
    prop_oneof![
        6 => (0usize..4, 0u64..4, 0u64..3, deadline, 1u64..200, 0u64..200).prop_map(
            |(priority, caller, hand, deadline_ms, least_ms, more_ms)| Step::Admit {
                priority, caller, hand, deadline_ms, least_ms, more_ms
            }
        ),
        1 => (0usize..4, 0u64..4).prop_map(|(priority, caller)| Step::Continue { priority, caller }),
        4 => Just(Step::Take),
        1 => (0u64..2).prop_map(Step::TakeSome),
        3 => (0usize..8).prop_map(Step::End),
        1 => (0usize..16).prop_map(Step::Withdraw),
        3 => (1u64..300).prop_map(Step::Wait),
        2 => Just(Step::Expire),
    ]
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum State {
    Waiting,
    Running,
    Ended(&'static str),
}

/// What the book-keeper knows of a job; its payload is its number.
#[derive(Debug, Clone)]
struct Record {
    ask: Ask,
    continues: bool,
    id: Option<JobId>,
    state: State,
}

struct Book {
    jobs: BTreeMap<u64, Record>,
}

impl Book {
    fn end(&mut self, job: u64, how: &'static str, from: State) {
        let record = self.jobs.get_mut(&job).unwrap();
        assert_eq!(record.state, from, "job {job} ends by {how}");
        record.state = State::Ended(how);
    }

    fn with(&self, state: State) -> impl Iterator<Item = (&u64, &Record)> {
        self.jobs.iter().filter(move |(_, r)| r.state == state)
    }

    fn nth(&self, state: State, n: usize) -> Option<(u64, JobId)> {
        let all: Vec<_> = self.with(state).map(|(job, r)| (*job, r.id.unwrap())).collect();
        (!all.is_empty()).then(|| all[n % all.len()])
    }

    fn free(&self, config: &Config, priority: Priority) -> usize {
        let running = self.with(State::Running).count();
        let ordinary = self.with(State::Running).filter(|(_, r)| r.ask.priority != Priority::Servo).count();
        let all = config.slots + config.servo_slots - running;
        if priority == Priority::Servo { all } else { all.min(config.slots - ordinary) }
    }
}

fn ms(n: u64) -> Duration {
    Duration::from_millis(n)
}

#[allow(clippy::too_many_lines)] // one match over what can happen
fn play(config: Config, steps: Vec<Step>) {
    let mut scheduler: Scheduler<u64> = Scheduler::new(config);
    let mut book = Book { jobs: BTreeMap::new() };
    let mut now = Time::ZERO;
    let mut begun_since_relief = 0u32;
    for step in steps {
        match step {
            Step::Admit { priority, caller, hand, deadline_ms, least_ms, more_ms } => {
                let ask = Ask {
                    priority: Priority::ALL[priority],
                    caller: Flow(caller),
                    hand: Flow(hand),
                    arrived: now,
                    deadline: deadline_ms.map(|d| now + ms(d)),
                    estimate: Estimate { least: ms(least_ms), expected: ms(least_ms + more_ms) },
                };
                let job = book.jobs.len() as u64;
                let waiting = book.with(State::Waiting).filter(|(_, r)| !r.continues).count();
                let limit = config.queue + book.free(&config, ask.priority);
                let mut record = Record { ask, continues: false, id: None, state: State::Waiting };
                match scheduler.admit(now, ask, job) {
                    Ok(Admitted { id, shed, position }) => {
                        assert_eq!(shed.is_some(), waiting >= limit, "the bound is exact");
                        record.id = Some(id);
                        book.jobs.insert(job, record);
                        if let Some(Shed { payload, .. }) = shed {
                            let lost = &book.jobs[&payload];
                            assert!(lost.ask.priority <= ask.priority && !lost.continues);
                            book.end(payload, "shed", State::Waiting);
                        }
                        assert!(position < book.with(State::Waiting).count());
                    }
                    Err(Refused { why, payload, retry_after }) => {
                        assert_eq!(payload, job);
                        assert!(retry_after >= ms(10));
                        record.state = State::Ended("refused");
                        book.jobs.insert(job, record);
                        match why {
                            Refusal::Full { waiting: told } => {
                                assert!(waiting >= limit && told == waiting, "the bound is exact");
                                let lower =
                                    |(_, r): (&u64, &Record)| !r.continues && r.ask.priority < ask.priority;
                                assert!(
                                    !book.with(State::Waiting).any(lower),
                                    "a lower priority kept its place"
                                );
                            }
                            Refusal::CannotFinish { needs, left } => assert!(needs > left),
                            Refusal::InTheWay => assert!(waiting > 0),
                        }
                    }
                }
            }
            Step::Continue { priority, caller } => {
                let job = book.jobs.len() as u64;
                let ask = Ask {
                    priority: Priority::ALL[priority],
                    caller: Flow(caller),
                    hand: Flow(0),
                    arrived: now.saturating_sub(ms(50)),
                    deadline: None,
                    estimate: Estimate { least: ms(5), expected: ms(20) },
                };
                let id = Some(scheduler.continue_call(now, ask, job));
                book.jobs.insert(job, Record { ask, continues: true, id, state: State::Waiting });
            }
            Step::Take | Step::TakeSome(_) => {
                let blocked = |job: u64| matches!(step, Step::TakeSome(parity) if job % 2 == parity);
                let can = |r: &Record| book.free(&config, r.ask.priority) > 0;
                let ready: Vec<_> =
                    book.with(State::Waiting).filter(|(job, r)| can(r) && !blocked(**job)).collect();
                let fit = |job: &u64| if blocked(*job) { Fit::NotYet } else { Fit::Now };
                let Some(begun) = scheduler.take(now, fit) else {
                    assert!(ready.is_empty(), "a slot is free and a job can begin: {ready:?}");
                    continue;
                };
                let job = begun.payload;
                let own = &book.jobs[&job];
                assert!(ready.iter().any(|(ready, _)| **ready == job), "job {job} could not begin");
                if begun.relieved {
                    assert!(begun_since_relief + 1 >= RELIEF, "one relief in {RELIEF}");
                    assert!(now - own.ask.arrived > config.patience);
                    begun_since_relief = 0;
                } else {
                    begun_since_relief += 1;
                    let due = |r: &Record| r.ask.deadline.unwrap_or(r.ask.arrived + config.patience);
                    for (other, r) in &ready {
                        assert!(r.ask.priority <= own.ask.priority, "{other} is more urgent than {job}");
                        if (r.ask.priority, r.ask.caller, r.ask.hand)
                            == (own.ask.priority, own.ask.caller, own.ask.hand)
                        {
                            assert!(due(r) >= due(own), "{other} is due before {job}");
                        }
                    }
                }
                let record = book.jobs.get_mut(&job).unwrap();
                assert_eq!(record.state, State::Waiting);
                record.state = State::Running;
                let ordinary = |(_, r): &(&u64, &Record)| r.ask.priority != Priority::Servo;
                assert!(book.with(State::Running).filter(ordinary).count() <= config.slots);
                assert!(book.with(State::Running).count() <= config.slots + config.servo_slots);
            }
            Step::End(n) => {
                if let Some((job, id)) = book.nth(State::Running, n) {
                    assert!(scheduler.end(now, id));
                    assert!(!scheduler.end(now, id), "a job ends once");
                    book.end(job, "done", State::Running);
                }
            }
            Step::Withdraw(n) => {
                if let Some((job, id)) = book.nth(State::Waiting, n) {
                    assert_eq!(scheduler.withdraw(id), Some(job));
                    assert_eq!(scheduler.withdraw(id), None);
                    book.end(job, "withdrawn", State::Waiting);
                }
            }
            Step::Wait(by) => now += ms(by),
            Step::Expire => {
                let first = book.with(State::Waiting).filter_map(|(_, r)| r.ask.deadline).min();
                assert_eq!(scheduler.next_expiry(), first);
                for (_, job) in scheduler.expire(now) {
                    assert!(book.jobs[&job].ask.deadline.unwrap() <= now);
                    book.end(job, "expired", State::Waiting);
                }
                assert!(scheduler.next_expiry().is_none_or(|next| next > now));
            }
        }
        assert_eq!(scheduler.waiting(), book.with(State::Waiting).count());
        assert_eq!(scheduler.running(), book.with(State::Running).count());
    }
    // Everything that is left can be run to its end, and nothing ends twice.
    loop {
        while let Some((job, id)) = book.nth(State::Running, 0) {
            assert!(scheduler.end(now, id));
            book.end(job, "done", State::Running);
        }
        let Some(begun) = scheduler.take(now, |_| Fit::Now) else { break };
        book.jobs.get_mut(&begun.payload).unwrap().state = State::Running;
    }
    for (job, record) in &book.jobs {
        assert!(matches!(record.state, State::Ended(_)), "job {job}: {record:?}");
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 400, ..ProptestConfig::default() })]

    #[test]
    fn bound_order_room_and_ends_hold(
        (slots, servo_slots, queue) in (1usize..4, 0usize..3, 0usize..8),
        patience_ms in 100u64..3000,
        steps in vec(step(), 1..160),
    ) {
        play(Config { slots, servo_slots, queue, patience: ms(patience_ms), plain_fifo: false }, steps);
    }

    /// Whoever is in the queue begins, however many more urgent calls come every time a slot is free.
    #[test]
    fn nobody_starves(
        queue in 2usize..10,
        waiting in 1usize..4,
        rivals in vec((1usize..4, 0u64..5, 50u64..500), 400),
    ) {
        let config = Config { slots: 1, servo_slots: 0, queue, patience: ms(500), plain_fifo: false };
        let mut scheduler: Scheduler<usize> = Scheduler::new(config);
        let mut now = Time::ZERO;
        let ask = |priority, caller, deadline: Option<Time>, now| Ask {
            priority, caller: Flow(caller), hand: Flow(caller), arrived: now, deadline,
            estimate: Estimate { least: ms(1), expected: ms(20) },
        };
        let waiting = waiting.min(queue);
        for i in 0..waiting {
            scheduler.continue_call(now, ask(Priority::Low, 9, None, now), i);
        }
        let mut begun = 0;
        // Patience, then one in RELIEF.
        let most = 25 + RELIEF as usize * (waiting + 1);
        for (taken, (priority, caller, deadline)) in rivals.into_iter().enumerate() {
            for _ in 0..2 {
                let rival = ask(Priority::ALL[priority], caller, Some(now + ms(deadline)), now);
                drop(scheduler.admit(now, rival, 100));
            }
            scheduler.expire(now);
            if let Some(next) = scheduler.take(now, |_| Fit::Now) {
                begun += usize::from(next.payload < 100);
                now += ms(20);
                scheduler.end(now, next.id);
            }
            if begun == waiting {
                return Ok(());
            }
            prop_assert!(taken <= most, "{begun} of {waiting} have begun after {taken} others");
        }
    }

    /// One caller that floods and one that asks now and then have the same share, and so have two hands.
    #[test]
    fn shares_are_fair(flood in 3usize..20, by_hand in any::<bool>(), seed in 0u64..1000) {
        let config = Config { slots: 1, servo_slots: 0, queue: 24, patience: ms(60_000), plain_fifo: false };
        let mut scheduler: Scheduler<usize> = Scheduler::new(config);
        let mut now = Time::ZERO;
        let mut served = [0u32; 2];
        for round in 0..400u64 {
            for who in [0usize, 1] {
                let places = scheduler.waiting_payloads().filter(|(_, p)| **p == who).count();
                let wanted = if who == 0 { flood.min(12) } else { 2 };
                for _ in places..wanted {
                    let flow = Flow(who as u64);
                    // The flood is always due sooner.
                    let due = now + ms(20_000 + 10_000 * who as u64 + (seed * round) % 97);
                    let ask = Ask {
                        priority: Priority::Normal,
                        caller: if by_hand { Flow(7) } else { flow },
                        hand: if by_hand { flow } else { Flow(7) },
                        arrived: now,
                        deadline: Some(due),
                        estimate: Estimate { least: ms(50), expected: ms(50) },
                    };
                    drop(scheduler.admit(now, ask, who));
                }
            }
            let next = scheduler.take(now, |_| Fit::Now).unwrap();
            served[next.payload] += 1;
            now += ms(50);
            scheduler.end(now, next.id);
        }
        let share = f64::from(served[1]) / 400.0;
        prop_assert!((0.45..0.55).contains(&share), "{served:?}");
    }
}

fn simple(priority: Priority, deadline: Option<u64>, least: u64) -> Ask {
    Ask {
        priority,
        caller: Flow(1),
        hand: Flow(1),
        arrived: Time::ZERO,
        deadline: deadline.map(ms),
        estimate: Estimate { least: ms(least), expected: ms(least) },
    }
}

fn scheduler(slots: usize, servo_slots: usize, queue: usize) -> Scheduler<&'static str> {
    Scheduler::new(Config { slots, servo_slots, queue, patience: ms(10_000), plain_fifo: false })
}

#[test]
fn what_cannot_finish_is_refused_and_told_when_it_could() {
    let mut s = scheduler(1, 0, 8);
    let now = Time::ZERO;
    s.admit(now, simple(Priority::Normal, None, 100), "runs").unwrap();
    s.take(now, |_| Fit::Now).unwrap();
    s.admit(now, simple(Priority::Normal, Some(250), 100), "waits").unwrap();
    let refused = s.admit(now, simple(Priority::Normal, Some(260), 100), "late").unwrap_err();
    assert_eq!(refused.why, Refusal::CannotFinish { needs: ms(300), left: ms(260) });
    assert_eq!(refused.retry_after, ms(40));
    // Due before "waits", and would push it past its deadline.
    let refused = s.admit(now, simple(Priority::Normal, Some(210), 100), "in the way").unwrap_err();
    assert_eq!(refused.why, Refusal::InTheWay);
    // The same for what is more urgent is no reason to refuse.
    s.admit(now, simple(Priority::High, Some(210), 100), "urgent").unwrap();
}

#[test]
fn servo_work_has_room_that_nobody_else_takes() {
    let mut s = scheduler(2, 1, 8);
    let now = Time::ZERO;
    for name in ["a", "b", "c"] {
        s.admit(now, simple(Priority::High, None, 100), name).unwrap();
    }
    assert!(s.take(now, |_| Fit::Now).is_some() && s.take(now, |_| Fit::Now).is_some());
    assert_eq!(s.take(now, |_| Fit::Now), None, "the third slot is for servo work");
    // Admitted although every ordinary slot is busy for longer than it has.
    s.admit(now, simple(Priority::Servo, Some(30), 20), "servo").unwrap();
    assert_eq!(s.take(now, |_| Fit::Now).unwrap().payload, "servo");
    let refused = s.admit(now, simple(Priority::Servo, Some(30), 20), "second").unwrap_err();
    assert!(matches!(refused.why, Refusal::CannotFinish { .. }));
}

#[test]
fn a_full_queue_makes_room_for_what_is_more_urgent_and_for_modest_callers() {
    let mut s = scheduler(1, 0, 3);
    let now = Time::ZERO;
    let ask = |priority, caller| Ask { caller: Flow(caller), ..simple(priority, None, 10) };
    s.admit(now, ask(Priority::Normal, 1), "runs").unwrap();
    s.take(now, |_| Fit::Now).unwrap();
    for name in ["1", "2", "3"] {
        s.admit(now, ask(Priority::Normal, 1), name).unwrap();
    }
    let full = s.admit(now, ask(Priority::Normal, 1), "4").unwrap_err();
    assert_eq!(full.why, Refusal::Full { waiting: 3 });
    assert_eq!(s.admit(now, ask(Priority::Normal, 2), "modest").unwrap().shed.unwrap().payload, "3");
    // Two and one: no more to take.
    assert!(s.admit(now, ask(Priority::Normal, 2), "again").is_err());
    let shed = s.admit(now, ask(Priority::High, 1), "urgent").unwrap().shed;
    assert!(shed.is_some());
    assert_eq!(s.calls_waiting(), 3);
}

#[test]
fn a_running_job_goes_on_only_while_nobody_misses_a_deadline_for_it() {
    let mut s = scheduler(1, 0, 8);
    let now = Time::ZERO;
    s.admit(now, simple(Priority::Normal, None, 20), "runs").unwrap();
    let id = s.take(now, |_| Fit::Now).unwrap().id;
    assert!(s.has_time(now, id, ms(5000)), "nobody waits");
    s.admit(now, simple(Priority::Normal, Some(100), 40), "waits").unwrap();
    assert!(s.has_time(now, id, ms(60)));
    assert!(!s.has_time(now, id, ms(61)));
    s.expect(id, ms(60));
    let refused = s.admit(now, simple(Priority::Normal, Some(139), 40), "late").unwrap_err();
    assert!(matches!(refused.why, Refusal::CannotFinish { .. }), "{refused:?}");
}
