// The colours of rays, their losses, and the gradients of the networks' outputs, which take the
// place of `density_rows` (only the density's column) and `colour_rows`: a thread a ray.
// `shaded` is used up. What is not seen gets no gradient: both are cleared before.

@group(0) @binding(1) var<storage, read> rays: array<Ray>;
@group(0) @binding(2) var<storage, read> steps: array<f32>;
@group(0) @binding(3) var<storage, read_write> shaded: array<vec4f>;
@group(0) @binding(4) var<storage, read_write> of_density: array<f32>;
@group(0) @binding(5) var<storage, read_write> of_colour: array<f32>;
// Loss, squared error, samples seen, transmittance.
@group(0) @binding(6) var<storage, read_write> results: array<vec4f>;

fn opacity(density: f32, dt: f32) -> f32 {
    return 1.0 - exp(-density * dt);
}

@compute @workgroup_size(64)
fn composite(@builtin(workgroup_id) group: vec3u, @builtin(local_invocation_index) local: u32) {
    let number = group.x * 64u + local;
    if (number >= job.rays) {
        return;
    }
    let begin = rays[number].begin;
    let truth = vec3f(rays[number].colour[0], rays[number].colour[1], rays[number].colour[2]);
    let background =
        vec3f(rays[number].background[0], rays[number].background[1], rays[number].background[2]);
    var through = 1.0;
    var shown = vec3f();
    var count = 0u;
    for (; count < rays[number].count; count++) {
        if (job.fast != 0u && through < job.opaque) {
            break;
        }
        let at = begin + count;
        let weight = through * opacity(shaded[at].w, steps[at]);
        shown += weight * shaded[at].xyz;
        through -= weight;
        // For the way back: the transmittance behind.
        of_density[at * job.density_width + job.density_column] = through;
    }
    shown += through * background;
    let e = shown - truth;
    let square = dot(e, e) / 3.0;
    var loss = square;
    var of_ray = 2.0 * e / 3.0;
    if (job.fast != 0u) {
        let size = abs(e);
        let far = job.linear_from * (size - 0.5 * job.linear_from);
        let terms = select(far, 0.5 * e * e, size < vec3f(job.linear_from));
        loss = (terms.x + terms.y + terms.z) / 3.0;
        of_ray = clamp(e, vec3f(-job.linear_from), vec3f(job.linear_from)) / 3.0;
    }
    of_ray *= job.weight;
    results[number] = vec4f(loss, square, f32(count), through);
    var behind = through * dot(of_ray, background);
    for (var i = count; i > 0u; i--) {
        let at = begin + i - 1u;
        let s = shaded[at];
        let place = at * job.density_width + job.density_column;
        let after = of_density[place];
        var before = 1.0;
        if (i > 1u) {
            before = of_density[place - job.density_width];
        }
        let weight = before * opacity(s.w, steps[at]);
        var g = steps[at] * (after * dot(of_ray, s.xyz) - behind);
        if (job.fast != 0u) {
            g *= s.w;
        } else if (s.w <= 0.0) {
            g = 0.0;
        }
        of_density[place] = g;
        let of_rgb = of_ray * weight;
        behind += dot(of_rgb, s.xyz);
        let of_logits = of_rgb * s.xyz * (1.0 - s.xyz);
        for (var c = 0u; c < 3u; c++) {
            of_colour[at * job.colour_width + c] = of_logits[c];
        }
    }
}
