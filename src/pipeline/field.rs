//! The stage `train` of the methods that make a field and no splat.

use super::{Pipeline, TRAIN, Until};
use crate::pictures::FIELD;
use crate::record::FieldSummary;
use crate::stage::{StageSpec, fingerprint};
use crate::times::Times;
use anyhow::Result;
use baselines::FieldConfig;
use std::path::Path;

impl Pipeline {
    /// Trains a field on the training set, whose identity is `print`, and the times of its photos,
    /// and judges it.
    pub(super) fn field(&mut self, set: (&Path, &Times), print: &str, until: Until) -> Result<()> {
        let method = self.args.method;
        let config = FieldConfig {
            time_limit: self.args.train.time_limit,
            limit_clock: self.args.train.limit_clock,
            checkpoint_every: self.args.train.checkpoint_every,
            seed: self.args.seed,
            device: self.args.train.device.clone(),
            ..FieldConfig::new(method, self.args.train.iterations)
        };
        let print =
            fingerprint(&(env!("BASELINES_SOURCES"), print, &self.args.dataset, &config, set.1.by_name()))?;
        let stage = StageSpec { name: "train", fingerprint: &print, owns: &TRAIN };
        let done = self.stages.run(&stage, |new| self.train_field(set, new, &print, config))?;
        self.stages.discard("train")?;
        let field: &FieldSummary = &done.finished.value;
        let line = format!(
            "{}, {} steps{}, {:.1} million parameters, by {}",
            method.name(),
            field.iterations,
            cut_short(field, self.args.train.time_limit),
            field.parameters as f64 / 1e6,
            field.by
        );
        let finished = self.finish("train", done, &line);
        let print = finished.identity()?;
        self.record.field = Some(finished.value);
        self.judge(&print, until)
    }

    /// Trains, with checkpoints in `.stages/train`, and writes the field into the folder `new`.
    fn train_field(
        &self,
        (training_set, times): (&Path, &Times),
        new: &Path,
        print: &str,
        mut config: FieldConfig,
    ) -> Result<FieldSummary> {
        crate::stage::free_large_blocks_at_once();
        let progress = self.progress("train");
        let checkpoints = self.stages.keep("train", print)?;
        let begun = config.limit_clock.seconds();
        let dataset = crate::evaluate::load_to_train(training_set, &self.args.dataset, &progress)?;
        config.seconds_gone = config.limit_clock.seconds() - begun;
        let of_views: Vec<f32> = dataset.views.iter().map(|v| times.of_view(&v.name)).collect();
        let result = baselines::train(&dataset, &of_views, &config, Some(&checkpoints), &progress)?;
        times.write(new)?;
        result.field.write(&new.join(FIELD))?;
        Ok(FieldSummary {
            method: config.method,
            parameters: result.parameters,
            iterations: result.iterations,
            curve: result.curve,
            by: result.by,
        })
    }
}

/// Says that a method did all the steps it can use before its time was up.
fn cut_short(field: &FieldSummary, limit: Option<f64>) -> String {
    let spent = field.curve.last().map(|p| p.seconds);
    match spent.zip(limit) {
        Some((spent, limit)) if spent < limit => {
            format!(" (all it can use: {spent:.0} of {limit:.0} s)")
        }
        _ => String::new(),
    }
}
