//! Jobs of an evaluation on all cores: taken in turn, each on one thread, answers in the order of the jobs.

use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Mutex, PoisonError};

use super::EvaluationError;

/// Does the jobs 0 to `jobs` − 1, `workers` at a time, and gives their answers in that order. After the first error
/// nobody begins another job.
///
/// Each worker has a pool of one thread: a planning time is then that of one job alone, while in one pool a plan that
/// waits for its parts would be given other jobs to do meanwhile.
///
/// # Errors
/// The first error of a job, and [`EvaluationError::Threads`].
pub(super) fn in_turn<T: Send>(
    jobs: usize,
    workers: usize,
    job: impl Fn(usize) -> Result<T, EvaluationError> + Sync,
) -> Result<Vec<T>, EvaluationError> {
    let next = AtomicUsize::new(0);
    let answers: Mutex<Vec<(usize, T)>> = Mutex::new(Vec::new());
    let failed: Mutex<Option<EvaluationError>> = Mutex::new(None);
    let work = || -> Result<(), EvaluationError> {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build()?;
        loop {
            let index = next.fetch_add(1, Ordering::Relaxed);
            if index >= jobs {
                return Ok(());
            }
            let answer = pool.install(|| job(index))?;
            answers.lock().unwrap_or_else(PoisonError::into_inner).push((index, answer));
        }
    };
    std::thread::scope(|scope| {
        for _ in 0..workers.min(jobs) {
            scope.spawn(|| {
                if let Err(error) = work() {
                    next.store(jobs, Ordering::Relaxed);
                    failed.lock().unwrap_or_else(PoisonError::into_inner).get_or_insert(error);
                }
            });
        }
    });
    if let Some(error) = failed.into_inner().unwrap_or_else(PoisonError::into_inner) {
        return Err(error);
    }
    let mut answers = answers.into_inner().unwrap_or_else(PoisonError::into_inner);
    answers.sort_by_key(|(index, _)| *index);
    Ok(answers.into_iter().map(|(_, answer)| answer).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn answers_come_in_the_order_of_the_jobs() {
        for workers in [1, 3, 20] {
            assert_eq!(
                in_turn(10, workers, |i| Ok(i * i)).unwrap(),
                (0..10).map(|i| i * i).collect::<Vec<_>>()
            );
        }
        assert!(in_turn(0, 2, Ok).unwrap().is_empty());
    }

    #[test]
    fn after_an_error_no_job_begins() {
        let begun = AtomicUsize::new(0);
        let answer = in_turn(1000, 1, |i| {
            begun.fetch_add(1, Ordering::Relaxed);
            if i == 3 {
                return Err(EvaluationError::Setting {
                    field: "jobs",
                    found: "3".into(),
                    expected: "no error".into(),
                });
            }
            Ok(i)
        });
        assert!(answer.is_err());
        assert_eq!(begun.into_inner(), 4);
    }
}
