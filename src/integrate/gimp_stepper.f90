!> One explicit step, written as the papers write it: a short list of passes over the particles with the nodal equations
!> between them. USL (Sulsky, Chen & Schreyer 1994), MUSL (Sulsky, Zhou & Schreyer 1995), USF and USAVG (Bardenhagen 2002,
!> Nairn 2003), all with the symplectic (leap-frog) step; beside them the integrators of gimp_generalized_alpha and gimp_newmark.
module gimp_stepper
  use gimp_kinds, only: wp, dp, i8
  use gimp_error, only: error_t, raise
  use gimp_text, only: text_of
  use gimp_timer, only: seconds_now
  use gimp_particles, only: few_chunks
  use gimp_engine, only: leaving_removes, pass_t, affine_none
  use gimp_walls, only: move_walls
  use gimp_nodes, only: stage_full, stage_velocity, stage_kick, stage_project
  use gimp_books, only: close_step
  use gimp_step_size, only: next_step, rule_adaptive, limit_output, limit_redone, most_halvings
  use gimp_chunk_state, only: elastic_energy_of, elastic_round_off
  use gimp_saved_state, only: save_particles
  use gimp_stability, only: critical_step, check_none, strains_plain, strains_after_kick, strains_smoothed
  use gimp_series, only: note_series, smooth_velocity, smooth_strain
  use gimp_generalized_alpha, only: alpha_stage, mapped_limit
  use gimp_newmark, only: begin_newmark, displace_stage, correct_stage, newmark_limit
  use gimp_run_state, only: stepper_t, hands_on, symplectic, generalized_alpha, newmark, flip_now, series_none, usf, usl, musl, usavg, damping_kinetic, phase_checks, set_bounds, find_held, kinetic_given, &
    momentum_of, weigh
  use gimp_particle_stage, only: run_pass, give_pass, state_pass, resort, filter_null_space
  use gimp_nodal_stage, only: nodal_stage
  use gimp_leaving, only: mark_leaving
  use gimp_undo, only: save_state, recall_state, went_wrong
  implicit none(type, external)
  private
  public :: start_run, resume_run, plan_step, take_step


contains

  !> First sort and first transfer to the grid; particles, laws, walls, loads and options are set
  subroutine start_run(s, error)
    type(stepper_t), intent(inout) :: s
    type(error_t), allocatable, intent(out) :: error
    call set_bounds(s)
    call resort(s)
    call weigh(s, s%books%mass, s%cutoff_mass, s%light_mass)
    s%light_mass = s%method%redistribute*s%light_mass*real(s%engine%grid%spacing, wp)**s%engine%grid%dim
    s%round_off_mass = 32.0_wp*epsilon(1.0_wp)*s%cutoff_mass
    s%cutoff_mass = s%method%cutoff*s%cutoff_mass
    call run_pass(s, give_pass(s, s%time), error)
    if (.not. allocated(error) .and. s%method%integrator == newmark) call begin_newmark(s, error)
    if (allocated(error)) return
    s%books%kinetic = kinetic_given(s)
    s%books%kinetic_start = s%books%kinetic
    s%books%momentum_start = momentum_of(s)
    s%books%largest = max(s%books%largest, s%books%kinetic)
    s%books%momentum_scale = max(s%books%momentum_scale, sqrt(2.0_dp*s%books%kinetic*s%books%mass))
    s%kinetic_peak = s%books%kinetic
    if (.not. s%time_options%redo) return
    s%stored = elastic_energy_of(s%engine)
    s%energy_noise = elastic_round_off(s%engine)
    call save_particles(s%engine%particles, s%engine%border%cut, .true., s%saved)
    s%saved%books%sorts = s%books%sorts
  end subroutine start_run

  !> Make ready for the next step after particles, blocks, pads and `carry_stepper` brought a state back
  subroutine resume_run(s)
    type(stepper_t), intent(inout) :: s
    call set_bounds(s)
    call find_held(s)
    if (.not. s%time_options%redo) return
    call save_particles(s%engine%particles, s%engine%border%cut, .true., s%saved)
    s%saved%books%sorts = s%books%sorts
  end subroutine resume_run

  !> Choose the next step; `until` is the time left to the next time of interest
  subroutine plan_step(s, until, error)
    type(stepper_t), intent(inout) :: s
    real(dp), intent(in) :: until !! [s]
    type(error_t), allocatable, intent(out) :: error
    real(dp) :: last
    logical :: checks
    last = s%free_dt
    checks = .false.
    if (s%time_options%check /= check_none) checks = modulo(s%step, int(s%time_options%check_every, i8)) == 0
    if (checks) call check_stability(s)
    call next_step(s%time_options, s%engine%grid%spacing, s%rate, merge(0.0_dp, s%speed, s%engine%total), s%strain_rate, s%critical, last, until, s%dt, &
                   s%free_dt, s%limit)
    if (checks) s%critical_share = max(s%critical_share, s%dt/s%critical)
    if (s%dt < s%time_options%smallest .and. s%limit /= limit_output) then
      call raise(error, "step "//text_of(s%step + 1)//", t = "//text_of(s%time)//" s: the step has collapsed to " &
                 //text_of(s%dt)//" s, below smallest_step = "//text_of(s%time_options%smallest)//" s")
    else if (s%time + s%dt == s%time) then
      call raise(error, "step "//text_of(s%step + 1)//", t = "//text_of(s%time)//" s: the step has collapsed to " &
                 //text_of(s%dt)//" s, too small to move the clock")
    end if
  end subroutine plan_step

  !> The critical step of the present state
  subroutine check_stability(s)
    type(stepper_t), intent(inout) :: s
    real(wp) :: factor
    real(dp) :: start
    integer :: strains
    start = seconds_now()
    factor = 1.0_wp
    if (s%method%integrator == generalized_alpha) then
      strains = strains_plain
      factor = (2.0_wp/mapped_limit(s%method%spectral_radius))**2
    else if (s%method%integrator == newmark) then
      strains = strains_smoothed
      factor = (2.0_wp/newmark_limit(s%method%newmark_gamma))**2
    else if (s%method%scheme == usl) then
      strains = strains_after_kick
    else if (s%engine%affine /= affine_none .or. s%method%series /= series_none) then
      strains = strains_plain
    else
      strains = strains_smoothed
      factor = 2.0_wp/(1.0_wp + s%method%flip)
    end if
    call critical_step(s%engine, s%walls, s%held, s%cutoff_mass, s%time_options%check, strains, factor, s%critical)
    s%least_critical = min(s%least_critical, s%critical)
    s%seconds(phase_checks) = s%seconds(phase_checks) + seconds_now() - start
  end subroutine check_stability

  !> Advance by s%dt; a step that goes wrong is undone and taken again at half the length, if the scene asks for it
  subroutine take_step(s, error)
    type(stepper_t), intent(inout) :: s
    type(error_t), allocatable, intent(out) :: error
    real(dp) :: dt
    integer :: k
    if (.not. s%time_options%redo) then
      call advance(s, error)
      return
    end if
    call save_state(s)
    do k = 0, most_halvings
      s%hopeless = .false.
      call advance(s, error)
      if (.not. went_wrong(s, allocated(error))) return
      if (k == most_halvings) exit
      dt = 0.5_dp*s%dt
      call recall_state(s, error)
      if (allocated(error)) return
      s%dt = dt
      s%free_dt = dt
      s%limit = limit_redone
      s%halvings = s%halvings + 1
      if (k == 0) s%redone_steps = s%redone_steps + 1
    end do
    if (allocated(error)) error%message = error%message//"; the step had been halved "//text_of(most_halvings)//" times"
  end subroutine take_step

  !> One attempt at a step
  subroutine advance(s, error)
    type(stepper_t), intent(inout) :: s
    type(error_t), allocatable, intent(out) :: error
    type(pass_t) :: first, second, last
    real(dp) :: kinetic, kick

    kick = s%kick_before + 0.5_dp*s%dt
    if (s%step == 0 .and. .not. s%method%half_start) kick = s%dt
    if (s%method%integrator /= symplectic) kick = s%dt ! its velocities are those of the end of the step
    s%books%work_external = 0.0_dp
    s%removed_kinetic = 0.0_dp
    call move_walls(s%walls, s%time + 0.5_dp*s%dt)
    first = pass_t(flip=flip_now(s), dt=real(s%dt, wp), dt_strain=real(s%dt, wp), kick=real(kick, wp), time=s%time)
    call note_series(s, first)
    last = first
    last%time = s%time + s%dt
    first%redistribute = hands_on(s%method) .and. (s%method%scheme == usf .or. s%method%scheme == usavg)

    select case (merge(s%method%scheme, -s%method%integrator, s%method%integrator == symplectic))
    case (-generalized_alpha)
      call alpha_stage(s, error)
      if (allocated(error)) return
      last%velocity = .true.; last%position = .true.; last%strain = .true.; last%back = 0.0_wp
    case (-newmark)
      call displace_stage(s)
      last%position = .true.; last%strain = .true.; last%own_kick = .true.
      last%kick = real((1.0_dp - s%method%newmark_gamma)*s%dt, wp)
    case (usl)
      call kick_nodes(s, kick, error)
      if (allocated(error)) return
      call smooth_velocity(s, kick, error)
      if (allocated(error)) return
      last%velocity = .true.; last%position = .true.; last%strain = .true.
    case (musl)
      call kick_nodes(s, kick, error)
      if (allocated(error)) return
      call smooth_velocity(s, kick, error)
      if (allocated(error)) return
      first%velocity = .true.; first%momentum = .true.; first%old_weights = .true.
      call run_pass(s, first, error)
      if (allocated(error)) return
      call nodal_stage(s, stage_project, kick)
      call smooth_strain(s, error)
      if (allocated(error)) return
      last%position = .true.; last%moved_by_second = .true.; last%strain = .true.
    case (usf)
      call nodal_stage(s, stage_velocity, kick)
      first%strain = .true.; first%force = .true.; first%old_weights = .true.
      call run_pass(s, first, error)
      if (allocated(error)) return
      call nodal_stage(s, stage_kick, kick)
      call smooth_velocity(s, kick, error)
      if (allocated(error)) return
      last%velocity = .true.; last%position = .true.
    case (usavg)
      call nodal_stage(s, stage_velocity, kick)
      first%strain = .true.; first%force = .true.; first%old_weights = .true.; first%dt_strain = real(0.5_dp*s%dt, wp)
      call run_pass(s, first, error)
      if (allocated(error)) return
      call nodal_stage(s, stage_kick, kick)
      call smooth_velocity(s, kick, error)
      if (allocated(error)) return
      second = pass_t(flip=flip_now(s), kick=real(kick, wp), velocity=.true., momentum=.true., old_weights=.true.)
      call note_series(s, second)
      call run_pass(s, second, error)
      if (allocated(error)) return
      call nodal_stage(s, stage_project, kick)
      last%position = .true.; last%moved_by_second = .true.; last%strain = .true.; last%dt_strain = real(0.5_dp*s%dt, wp)
    end select
    call finish_pass(s, last, error)
    if (.not. allocated(error) .and. s%method%integrator == newmark) call correct_stage(s, error)
    if (allocated(error)) return

    kinetic = kinetic_given(s)
    if (s%method%integrator == newmark) then ! whose works change the energy of particles: nodes have none of their own
      s%books%grid_after = kinetic + s%removed_kinetic
    end if
    call close_step(s%books, kinetic + s%removed_kinetic)
    s%books%kinetic = kinetic
    s%step = s%step + 1
    s%time = s%time + s%dt
    if (s%time_options%rule /= rule_adaptive) s%time = s%step*s%time_options%step
    s%kick_before = 0.5_dp*s%dt
    s%particle_steps = s%particle_steps + s%engine%particles%n_all
    if (s%method%damping == damping_kinetic) call relax(s, kinetic, error)
  end subroutine advance

  !> Velocities of the nodes and their kick. Where light nodes hand on force, masses must be known before forces are given: a pass
  !> of their own
  subroutine kick_nodes(s, kick, error)
    type(stepper_t), intent(inout) :: s
    real(dp), intent(in) :: kick
    type(error_t), allocatable, intent(out) :: error
    if (.not. hands_on(s%method)) then
      call nodal_stage(s, stage_full, kick)
      return
    end if
    call nodal_stage(s, stage_velocity, kick)
    call run_pass(s, pass_t(force=.true., old_weights=.true., redistribute=.true., kick=real(kick, wp), time=s%time), error)
    if (allocated(error)) return
    call nodal_stage(s, stage_kick, kick)
  end subroutine kick_nodes

  !> Last pass of a step: take and give at once, or with a sort between when one is due
  subroutine finish_pass(s, last, error)
    type(stepper_t), intent(inout) :: s
    type(pass_t), intent(in) :: last
    type(error_t), allocatable, intent(out) :: error
    type(pass_t) :: give, both
    logical, allocatable :: leaving(:, :)
    logical :: removes, filters
    removes = any(s%walls%side%removes)
    if (allocated(s%engine%leaving)) removes = any(s%engine%leaving == leaving_removes)
    filters = .false.
    if (s%method%filter_every > 0) filters = modulo(s%step + 1, int(s%method%filter_every, i8)) == 0
    s%sort_now = s%sort_now .or. filters ! which takes the particles of a cell from one block
    if (s%method%sort_every > 0) s%sort_now = s%sort_now .or. modulo(s%step + 1, int(s%method%sort_every, i8)) == 0
    give = give_pass(s, last%time)
    if (.not. (s%sort_now .or. removes)) then
      both = last
      both%momentum = give%momentum
      both%force = give%force
      call run_pass(s, both, error)
      return
    end if
    call run_pass(s, last, error)
    if (allocated(error)) return
    if (removes) call mark_leaving(s, leaving)
    if (removes .and. allocated(leaving)) then
      call resort(s, leaving)
    else if (s%sort_now) then
      call resort(s)
    end if
    if (filters) call filter_null_space(s)
    call run_pass(s, give, error)
  end subroutine finish_pass

  !> Kinetic damping: at a maximum of the kinetic energy all velocities are set to zero (dynamic relaxation)
  subroutine relax(s, kinetic, error)
    type(stepper_t), intent(inout) :: s
    real(dp), intent(in) :: kinetic
    type(error_t), allocatable, intent(out) :: error
    integer :: c, k, v
    if (kinetic >= s%kinetic_peak) then
      s%kinetic_peak = kinetic
      return
    end if
    v = s%engine%particles%velocity%first
    s%books%impulse = s%books%impulse - momentum_of(s)
    !$omp parallel do schedule(static) private(k) if(s%engine%particles%chunks > few_chunks)
    do c = 1, s%engine%particles%chunks
      s%engine%particles%p(:, v:v + s%engine%grid%dim - 1, c) = 0.0_wp
      do k = 1, s%engine%particles%affine%components
        s%engine%particles%p(:, s%engine%particles%affine%first + k - 1, c) = 0.0_wp
      end do
    end do
    !$omp end parallel do
    s%books%damping = s%books%damping + kinetic
    s%books%kinetic = 0.0_dp
    s%kinetic_peak = 0.0_dp
    s%kick_before = 0.0_dp ! leap-frog starts anew with half a kick
    s%power(1, :) = 0.0_dp
    call run_pass(s, state_pass(s, s%time), error)
  end subroutine relax

end module gimp_stepper
