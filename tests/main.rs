//! All tests that span several modules, in one binary. `libtest-mimic` replaces the built-in
//! harness, because tests that need a graphics adapter must be reported as ignored, not as passed,
//! if there is none. With INCISE_REQUIRE_ADAPTER set (CI), a missing adapter is a failure.
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    reason = "a test that cannot go on should panic"
)]
#![allow(missing_docs, reason = "tests say what they hold in their names")]

mod antialias;
mod architecture;
mod closed_forms;
mod command_line;
mod comparison;
mod composition;
mod contract;
mod damage;
mod defaults;
mod dicom_out;
#[cfg(feature = "gpu")]
mod editing;
mod faults;
mod fields;
mod filters;
mod functions;
mod fuzz;
mod kinds;
mod light;
mod mapping;
mod metrics;
mod nifti;
#[cfg(feature = "gpu")]
mod parity;
mod placement;
mod readers;
mod scenes;
mod settings;
#[cfg(feature = "gpu")]
mod shaders;
mod slices;
mod surfaces;
#[cfg(unix)]
mod tears;
mod trust;
#[cfg(feature = "gui")]
mod workstation;

use libtest_mimic::{Arguments, Failed, Trial};
use std::time::{Duration, Instant};

/// Tests that measure the time and memory of their process run in a process of their own: otherwise
/// they wait for other tests' threads and count other tests' memory. Each is listed under the name
/// of the trial that runs it.
const ALONE: &[(&str, fn())] = &[
    (
        "damage::mutated_files_do_no_harm",
        damage::mutated_files_do_no_harm,
    ),
    #[cfg(feature = "gui")]
    (
        "workstation::a_monkey_does_no_harm",
        workstation::a_monkey_does_no_harm,
    ),
];

/// The environment variable with the name of the entry of `ALONE` that a child process runs.
const ALONE_VARIABLE: &str = "INCISE_TEST_ALONE";

fn alone() -> impl Iterator<Item = Trial> {
    ALONE.iter().map(|&(name, _)| {
        trial(name, move || {
            let program = std::env::current_exe()?;
            let status = std::process::Command::new(program)
                .env(ALONE_VARIABLE, name)
                // Blocks above this size go back to the system when they are freed (glibc).
                .env("MALLOC_MMAP_THRESHOLD_", "131072")
                .status()?;
            if status.success() {
                Ok(())
            } else {
                Err(format!("{status}; what it said is above").into())
            }
        })
    })
}

/// Tests that take longer than this print how long they took.
const SLOW: Duration = Duration::from_secs(5);

/// A test that prints its time if it is slow.
fn trial(name: impl Into<String>, test: impl FnOnce() -> Result<(), Failed> + Send + 'static) -> Trial {
    let name = name.into();
    let shown = name.clone();
    Trial::test(name, move || {
        let start = Instant::now();
        let outcome = test();
        let elapsed = start.elapsed();
        if elapsed >= SLOW {
            eprintln!("{shown} took {:.0} s", elapsed.as_secs_f32());
        }
        outcome
    })
}

/// A test by the name of its function.
macro_rules! trials {
    ($module:ident: $($name:ident),* $(,)?) => {
        vec![$(trial(
            concat!(stringify!($module), "::", stringify!($name)),
            || { $module::$name(); Ok(()) },
        )),*]
    };
}

fn main() {
    #[cfg(feature = "gui")]
    if std::env::var_os(workstation::CHILD).is_some() {
        return workstation::edit_until_killed();
    }
    if let Some(name) = std::env::var_os(ALONE_VARIABLE) {
        let (_, test) = ALONE.iter().find(|(known, _)| name == *known).unwrap();
        return test();
    }
    let arguments = Arguments::from_args();
    let mut all: Vec<Trial> = Vec::new();
    all.extend(alone());
    all.extend(trials!(architecture:
        modules_name_only_those_before_them, no_circles_between_files, only_one_module_opens_files,
        files_and_functions_are_of_readable_size, names_are_plain));
    all.extend(trials!(metrics: equal_pictures_are_equal, the_comparer_rejects));
    all.extend(contract::trials());
    all.extend(trials!(closed_forms:
        transmittance_of_a_uniform_ball, identity_map_changes_nothing, translation_as_a_map_is_a_translation,
        normals_under_linear_maps, normals_under_a_twist, normals_on_cut_faces, anisotropic_ball_is_round,
        oblique_ball_is_round_and_lit_alike, path_through_a_cut_slab_is_exact, composition_is_the_formula,
        depth_of_projections, holes_are_empty));
    all.extend(trials!(light:
        occlusion_of_a_corner_a_slot_and_a_bowl, open_faces_stay_bright, shadow_of_a_plate_on_a_floor,
        shadow_of_a_slab_is_its_transmittance, shadows_follow_the_deformation, light_volume_agrees_with_rays));
    all.extend(trials!(scenes:
        every_scene_loads_and_comes_back, every_version_is_read, skipping_and_termination_change_nothing,
        halving_the_step_changes_little, what_holds_a_volume_is_kept, cuts_are_lit_alike_at_every_step,
        order_of_deformations_matters, left_is_left, empty_pictures_say_why));
    all.extend(trials!(antialias:
        adaptive_pictures_approach_the_average, adaptive_pictures_are_the_same_on_any_number_of_threads));
    all.extend(trials!(defaults:
        the_first_picture_shows_the_object, the_range_alone_shows_a_box, shifted_hounsfield_units_are_recognised));
    all.extend(trials!(placement:
        every_kind_shows_without_numbers, sampling_moves_nothing, placed_numbers_stay,
        version_1_keeps_the_volumes_box,
        what_is_visible_is_found, what_is_not_seen_is_named));
    all.extend(trials!(settings:
        every_setting_acts, settings_without_effect_are_named, every_setting_is_tested));
    all.extend(trials!(mapping:
        slabs_become_shells, files_are_mapped_round, bounds_hold_round_an_axis, more_than_half_a_turn_is_found,
        exports_keep_the_mapping, one_file_at_two_stages));
    all.extend(trials!(slices:
        slices_equal_rays_in_orthographic_views, slices_approach_rays, slices_show_surfaces,
        slices_show_whole_surfaces, nothing_is_seen_behind_the_eye,
        options_of_slices_are_bounded));
    all.extend(trials!(filters: filters_change_little));
    all.extend(trials!(kinds: displacement_is_continuous_where_it_shows));
    all.extend(trials!(functions:
        voxels_approach_their_function, phantoms_are_their_functions, functions_are_skipped_and_sliced,
        mistakes_in_functions_are_named));
    all.extend(trials!(tears:
        tears_have_their_amount, only_what_is_seen_tears, remedies_can_be_followed));
    all.extend(trials!(nifti:
        every_type_and_byte_order, rescale_is_sanitised, sform_qform_and_spacing, damaged_files_are_named,
        the_first_of_a_series_is_taken, the_bundled_head));
    all.extend(trials!(fields:
        baking_is_itk_resampling, affine_conventions_agree, vectors_turn_with_their_axes,
        all_orientations_agree, live_is_the_baked_picture, long_stacks_are_composed,
        composition_keeps_its_bound, fsl_warp_is_inverted, radial_field_is_inverted, written_files_come_back,
        composed_stacks_are_one_map, groups_with_a_vanished_member, baking_keeps_nan_in_its_place));
    all.extend(trials!(readers:
        one_phantom_in_every_format, scans_are_what_peers_read, real_series_have_their_geometry,
        orientations_are_one_world, series_are_listed_and_chosen, loads_are_watched, several_values_per_voxel,
        a_gigabyte_needs_little_more));
    all.extend(trials!(faults:
        listed_files, dicom_files, contours, arrays, headers_meshes_and_transforms));
    all.extend(trials!(dicom_out:
        an_oblique_tilted_grid_comes_back, values_come_back, no_patient_without_the_option,
        the_same_input_gives_the_same_bytes, a_picture_is_that_of_the_png, cuts_are_padding,
        nothing_is_mixed_or_lost, label_maps_become_segmentations, skewed_rows_are_refused));
    all.extend(trials!(damage: damaged_files_are_named));
    all.extend(trials!(fuzz: random_scenes_do_no_harm));
    all.extend(trials!(composition: random_stacks_keep_their_bound, tears_are_walked));
    all.extend(trials!(surfaces:
        distances_of_closed_forms, broken_meshes_keep_their_inside, thin_flat_and_far_things,
        a_part_is_part_of_the_whole, deformed_sphere_is_the_ellipsoid, narrow_pull_is_found_by_jacobian_steps,
        three_modes_share_one_deformation, two_stages_are_one_picture, skipping_changes_no_surface, skipping_loses_no_hit,
        rays_along_the_faces_of_cells,
        cut_models_are_what_they_say, surfaces_and_volumes_share_depth, volumes_inside_meshes,
        every_format_is_one_mesh, shared_meshes_load_or_say_why, depth_map_cube_shows_the_field));
    #[cfg(feature = "gpu")]
    all.extend(trials!(shaders:
        every_program_is_valid, uniforms_match_their_structs, counterparts_exist, sampled_textures_leave_room,
        functions_are_paired));
    all.extend(trials!(command_line:
        bad_input_is_named_and_leaves_no_file, bad_deformations_are_named, maps_and_bakes_by_the_command_line,
        same_bytes_for_any_number_of_threads, cpu_is_used_without_a_driver, stats_are_complete,
        an_existing_file_is_replaced_whole, meshes_and_fields_by_the_command_line, info_tells_what_is_needed,
        usage_errors_exit_with_2));
    #[cfg(unix)]
    all.extend(trials!(trust:
        every_writer_into_every_place, standard_output_takes_a_picture, what_cannot_be_printed_is_an_error,
        nothing_unfinished_is_left, every_reader_of_every_kind_of_file, files_do_not_reach_outside,
        names_that_are_no_text));
    all.extend(trials!(comparison:
        a_sweep_is_whole_and_converges, only_like_is_compared_with_like, what_cannot_be_compared_is_told,
        a_missing_gpu_is_told));
    #[cfg(feature = "gpu")]
    all.extend(comparison::on_a_gpu());
    #[cfg(feature = "gpu")]
    all.extend(parity::trials());
    #[cfg(all(feature = "gui", target_os = "linux"))]
    all.extend(trials!(command_line: no_display_is_told));
    #[cfg(feature = "gui")]
    all.extend(trials!(workstation:
        every_panel_is_there, a_peel_is_placed_undone_saved_and_opened_again, lasso_cuts_and_restores,
        renderers_are_compared_and_reported, broken_files_are_told, loading_is_cancelled,
        dragging_never_waits, the_last_save_opens_after_a_crash, slices_show_deformed_and_source,
        a_brush_paints_and_a_map_is_used_again, the_transfer_function_is_edited, measures_ride_along,
        exports_are_written, unsaved_work_is_asked_about, a_missing_file_is_located,
        the_palette_finds_commands, views_turn_pan_and_zoom, what_is_drawn_over_a_picture_belongs_to_it,
        a_picture_that_fails_keeps_its_letters, uneven_slices_are_told_and_mended,
        a_field_refuses_what_it_cannot_use, where_matter_came_from_is_exact));
    #[cfg(feature = "gui")]
    all.extend(workstation::on_a_gpu());
    libtest_mimic::run(&arguments, all).exit();
}
