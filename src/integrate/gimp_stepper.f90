!> One explicit step, written as the papers write it: a short list of passes over the particles with the nodal equations
!> between them. USL (Sulsky, Chen & Schreyer 1994), MUSL (Sulsky, Zhou & Schreyer 1995), USF and USAVG (Bardenhagen 2002,
!> Nairn 2003), all with the symplectic (leap-frog) step.
module gimp_stepper
  use gimp_kinds, only: wp, dp, i8, lanes
  use gimp_error, only: error_t, raise
  use gimp_text, only: text_of
  use gimp_timer, only: seconds_now
  use gimp_parcel, only: parcel_t, carry, carry_bits
  use gimp_accumulator, only: column_sums
  use gimp_grid, only: nodes_per_block, nf => fields_per_node, node_mass, has_images
  use gimp_blocks, only: few_blocks
  use gimp_particles, only: few_chunks
  use gimp_images, only: note_images, fold_images, copy_images
  use gimp_material, only: most_states
  use gimp_engine, only: engine_t, pass_t, engine_bytes, n_sums, sum_kinetic, sum_external, sum_plastic, sum_clamped, sum_wide, sum_impulse, sum_affine, affine_none, &
    peak_rate, peak_speed, peak_strain, fate_fine, fate_inverted, fate_outside, fate_jumped
  use gimp_particle_pass, only: particle_pass
  use gimp_pads, only: sum_pads, add_spills
  use gimp_resort, only: sort_particles
  use gimp_walls, only: walls_t, walls_near, move_walls, side_free
  use gimp_loads, only: loads_t, gravity_at, collect_loads, add_loads, work_of_loads
  use gimp_nodes, only: update_nodes, node_step_t, stage_full, stage_velocity, stage_kick, stage_project, n_node_sums, &
    book_before, book_after, book_given, book_forces, book_gravity, book_walls, book_damping, book_cut, book_cut_momentum, &
    book_reaction, book_pushed, book_impulse, book_held
  use gimp_books, only: books_t, close_step, energy_from_nothing
  use gimp_step_size, only: time_options_t, next_step, limit_output, limit_redone, most_halvings
  use gimp_chunk_state, only: chunk_deformation, chunk_history, elastic_energy_of, elastic_round_off
  use gimp_saved_state, only: saved_state_t, clock_t, save_particles, recall_particles, saved_bytes
  use gimp_stability, only: critical_step, check_none, strains_plain, strains_after_kick, strains_smoothed
  implicit none(type, external)
  private
  public :: stepper_t, method_t, start_run, carry_stepper, resume_run, plan_step, take_step, stepper_bytes, usf, usl, musl, usavg
  public :: damping_none, damping_local, damping_kinetic, scheme_of_word
  public :: phase_grid, phase_particles, phase_sort, phase_checks, n_phases

  integer, parameter :: usf = 1, usl = 2, musl = 3, usavg = 4
  integer, parameter :: damping_none = 0, damping_local = 1, damping_kinetic = 2
  integer, parameter :: phase_grid = 1, phase_particles = 2, phase_sort = 3, n_phases = 4
  integer, parameter :: phase_checks = 4 !! critical step, and the copy of the state for steps that may be redone

  !> How a step is taken
  type :: method_t
    integer :: scheme = musl
    real(wp) :: flip = 1.0_wp !! share of FLIP in the velocity transfer; 0 is PIC
    real(wp) :: cutoff = 1.0e-12_wp !! mass cut-off, in units of the largest particle mass
    logical :: half_start = .true. !! the first kick covers half a step, so that velocities live at half steps
    integer :: damping = damping_none
    real(wp) :: damping_factor = 0.7_wp
    integer :: sort_every = 0 !! steps; 0: when needed
  end type method_t

  !> A run in progress
  type :: stepper_t
    type(engine_t) :: engine
    type(method_t) :: method
    type(time_options_t) :: time_options
    type(walls_t) :: walls
    type(loads_t) :: loads
    type(books_t) :: books
    real(dp) :: time = 0.0_dp !! of positions [s]
    integer(i8) :: step = 0
    real(dp) :: dt = 0.0_dp !! of the last step [s]
    real(dp) :: free_dt = 0.0_dp !! the same before it was shortened to meet a time of interest
    integer :: limit = 1 !! what set dt
    real(dp) :: critical = huge(1.0_dp), least_critical = huge(1.0_dp) !! critical step when last checked, least of all [s]
    real(dp) :: critical_share = 0.0_dp !! largest dt/critical of the steps checked
    integer(i8) :: redone_steps = 0, halvings = 0 !! steps that were undone, and how often in all
    real(dp) :: rate = 0.0_dp, speed = 0.0_dp, strain_rate = 0.0_dp !! peaks of the last step
    real(dp) :: kick_before = 0.0_dp !! half of the last step: leap-frog with changing steps
    real(wp) :: cutoff_mass = 0.0_wp, round_off_mass = 0.0_wp !! [kg]
    integer(i8) :: particle_steps = 0
    real(dp) :: seconds(n_phases) = 0.0_dp
    logical, allocatable, private :: held(:) !! (slot) touched by a side of the box
    real(wp), allocatable, private :: raw(:, :, :) !! sums of pads, when images, loads or spills need them all at once
    real(wp), allocatable, private :: at_images(:, :) !! (field, image) given to images before they were folded
    logical, private :: sort_now = .false.
    real(dp), private :: sums(n_sums) = 0.0_dp !! of all blocks over the last pass
    real(dp), private :: kinetic_peak = 0.0_dp
    real(dp), private :: removed_kinetic = 0.0_dp !! left with particles in this step [J]
    type(saved_state_t), private :: saved !! start of the step in hand, if steps may be redone
    real(dp), private :: stored = 0.0_dp !! elastic energy now, if steps may be redone [J]
    real(dp), private :: energy_noise = 0.0_dp !! round-off of that [J]
    logical, private :: hopeless = .false. !! the step failed in a way that a shorter one does not cure
  end type stepper_t

contains

  !> Number of a scheme from its word, 0 for none
  pure integer function scheme_of_word(word) result(scheme)
    character(len=*), intent(in) :: word
    select case (word)
    case ("usf"); scheme = usf
    case ("usl"); scheme = usl
    case ("musl"); scheme = musl
    case ("usavg"); scheme = usavg
    case default; scheme = 0
    end select
  end function scheme_of_word

  !> First sort and first transfer to the grid; particles, laws, walls, loads and options are set
  subroutine start_run(s, error)
    type(stepper_t), intent(inout) :: s
    type(error_t), allocatable, intent(out) :: error
    call set_bounds(s)
    call resort(s)
    call weigh(s, s%books%mass, s%cutoff_mass)
    s%round_off_mass = 32.0_wp*epsilon(1.0_wp)*s%cutoff_mass
    s%cutoff_mass = s%method%cutoff*s%cutoff_mass
    call run_pass(s, give_pass(s, s%time), error)
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
    call save_particles(s%engine%particles, .true., s%saved)
    s%saved%books%sorts = s%books%sorts
  end subroutine start_run

  !> Bytes in use: the engine's, and those of the state that steps may be redone from
  pure integer(i8) function stepper_bytes(s)
    type(stepper_t), intent(in) :: s
    stepper_bytes = engine_bytes(s%engine) + saved_bytes(s%saved)
  end function stepper_bytes

  !> Where particles may be: one cell beyond the box, not beyond a free side that does not take them out
  subroutine set_bounds(s)
    type(stepper_t), intent(inout) :: s
    integer :: k
    do k = 1, s%engine%grid%dim
      s%engine%allowed_low(k) = -1.0_wp
      s%engine%allowed_high(k) = s%engine%grid%cells(k) + 1.0_wp
      if (s%walls%side(1, k)%condition == side_free .and. .not. s%walls%side(1, k)%removes) s%engine%allowed_low(k) = 0.0_wp
      if (s%walls%side(2, k)%condition == side_free .and. .not. s%walls%side(2, k)%removes) &
        s%engine%allowed_high(k) = s%engine%grid%cells(k)
      if (s%engine%grid%periodic(k)) then
        s%engine%allowed_low(k) = -huge(1.0_wp) ! positions wrap around at the next sort
        s%engine%allowed_high(k) = huge(1.0_wp)
      end if
      if (s%engine%grid%open_degree > 0) then ! the knots end there
        s%engine%allowed_low(k) = 0.0_wp
        s%engine%allowed_high(k) = s%engine%grid%cells(k)
      end if
    end do
  end subroutine set_bounds

  !> Pack or unpack all that steers later steps and does not follow from the scene, but for particles, blocks and pads
  pure subroutine carry_stepper(s, parcel)
    type(stepper_t), intent(inout) :: s
    type(parcel_t), intent(inout) :: parcel
    integer(i8) :: words(storage_size(s%books)/64)
    integer :: k
    call carry(parcel, s%time)
    call carry(parcel, s%step)
    call carry(parcel, s%dt)
    call carry(parcel, s%free_dt)
    call carry(parcel, s%limit)
    call carry(parcel, s%rate)
    call carry(parcel, s%speed)
    call carry(parcel, s%strain_rate)
    call carry(parcel, s%kick_before)
    call carry(parcel, s%cutoff_mass)
    call carry(parcel, s%round_off_mass)
    call carry(parcel, s%particle_steps)
    do k = 1, n_phases
      call carry(parcel, s%seconds(k))
    end do
    do k = 1, n_sums
      call carry(parcel, s%sums(k))
    end do
    call carry(parcel, s%sort_now)
    call carry(parcel, s%kinetic_peak)
    call carry(parcel, s%stored)
    call carry(parcel, s%energy_noise)
    call carry(parcel, s%critical)
    call carry(parcel, s%least_critical)
    call carry(parcel, s%critical_share)
    call carry(parcel, s%redone_steps)
    call carry(parcel, s%halvings)
    words = transfer(s%books, words)
    call carry_bits(parcel, words)
    if (parcel%reading) s%books = transfer(words, s%books)
  end subroutine carry_stepper

  !> Make ready for the next step after particles, blocks, pads and `carry_stepper` brought a state back
  subroutine resume_run(s)
    type(stepper_t), intent(inout) :: s
    call set_bounds(s)
    call find_held(s)
    if (.not. s%time_options%redo) return
    call save_particles(s%engine%particles, .true., s%saved)
    s%saved%books%sorts = s%books%sorts
  end subroutine resume_run

  !> Kinetic energy of the particles as they last gave to the grid, that of their affine parts included [J]
  pure real(dp) function kinetic_given(s)
    type(stepper_t), intent(in) :: s
    kinetic_given = s%sums(sum_kinetic) + s%sums(sum_affine)
  end function kinetic_given

  !> Momentum of all particles [kg m/s]
  function momentum_of(s) result(momentum)
    type(stepper_t), intent(in) :: s
    real(dp) :: momentum(3)
    real(dp), allocatable :: part(:, :) ! (axis, group)
    integer :: g, c, k
    allocate (part(3, size(s%engine%particles%groups)), source=0.0_dp)
    associate (particles => s%engine%particles)
      !$omp parallel do schedule(static) private(c, k) if(particles%chunks > few_chunks)
      do g = 1, size(particles%groups)
        do c = particles%groups(g)%first, particles%groups(g)%last
          do k = 1, s%engine%grid%dim
            part(k, g) = part(k, g) + sum(real(particles%p(:, particles%mass%first, c), dp) &
                                          *particles%p(:, particles%velocity%first + k - 1, c))
          end do
        end do
      end do
      !$omp end parallel do
    end associate
    call column_sums(part, momentum)
  end function momentum_of

  !> Mass of all particles and of the heaviest one [kg]
  subroutine weigh(s, mass, heaviest)
    type(stepper_t), intent(in) :: s
    real(dp), intent(out) :: mass
    real(wp), intent(out) :: heaviest
    real(dp), allocatable :: part(:, :) ! (1, group)
    real(dp) :: sums(1)
    integer :: g, c
    allocate (part(1, size(s%engine%particles%groups)), source=0.0_dp)
    heaviest = 0.0_wp
    associate (particles => s%engine%particles)
      !$omp parallel do schedule(static) private(c) reduction(max:heaviest) if(particles%chunks > few_chunks)
      do g = 1, size(particles%groups)
        do c = particles%groups(g)%first, particles%groups(g)%last
          part(1, g) = part(1, g) + sum(real(particles%p(:, particles%mass%first, c), dp))
          heaviest = max(heaviest, maxval(particles%p(:, particles%mass%first, c)))
        end do
      end do
      !$omp end parallel do
    end associate
    call column_sums(part, sums)
    mass = sums(1)
  end subroutine weigh

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
    call next_step(s%time_options, s%engine%grid%spacing, s%rate, s%speed, s%strain_rate, s%critical, last, until, s%dt, &
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
    if (s%method%scheme == usl) then
      strains = strains_after_kick
    else if (s%engine%affine /= affine_none) then
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

  !> Keep the state at the start of a step
  subroutine save_state(s)
    type(stepper_t), intent(inout) :: s
    real(dp) :: start
    start = seconds_now()
    call save_particles(s%engine%particles, s%books%sorts /= s%saved%books%sorts, s%saved)
    s%saved%books = s%books
    s%saved%clock = clock_t(time=s%time, step=s%step, particle_steps=s%particle_steps, dt=s%dt, free_dt=s%free_dt, &
                            kick_before=s%kick_before, rate=s%rate, speed=s%speed, strain_rate=s%strain_rate, &
                            sort_now=s%sort_now, kinetic_peak=s%kinetic_peak, stored=s%stored)
    s%seconds(phase_checks) = s%seconds(phase_checks) + seconds_now() - start
  end subroutine save_state

  !> Back to the start of the step: particles and blocks, then pads as they were, then clock and books
  subroutine recall_state(s, error)
    type(stepper_t), intent(inout) :: s
    type(error_t), allocatable, intent(out) :: error
    logical :: sorted
    sorted = s%books%sorts /= s%saved%books%sorts
    call recall_particles(s%saved, sorted, s%engine)
    if (sorted) call find_held(s)
    associate (clock => s%saved%clock)
      call run_pass(s, give_pass(s, clock%time), error)
      s%time = clock%time
      s%step = clock%step
      s%particle_steps = clock%particle_steps
      s%kick_before = clock%kick_before
      s%rate = clock%rate
      s%speed = clock%speed
      s%strain_rate = clock%strain_rate
      s%sort_now = clock%sort_now
      s%kinetic_peak = clock%kinetic_peak
      s%stored = clock%stored
    end associate
    s%books = s%saved%books ! the pass has booked what it counts once more
  end subroutine recall_state

  !> Whether the step just taken is to be redone: a particle failed, or energy came out of nothing
  logical function went_wrong(s, failed)
    type(stepper_t), intent(inout) :: s
    logical, intent(in) :: failed
    real(dp) :: start
    went_wrong = failed .and. .not. s%hopeless
    if (failed) return
    start = seconds_now()
    s%stored = elastic_energy_of(s%engine)
    went_wrong = energy_from_nothing(s%saved%books, s%saved%clock%stored, s%books, s%stored, s%energy_noise)
    s%seconds(phase_checks) = s%seconds(phase_checks) + seconds_now() - start
  end function went_wrong

  !> One attempt at a step
  subroutine advance(s, error)
    type(stepper_t), intent(inout) :: s
    type(error_t), allocatable, intent(out) :: error
    type(pass_t) :: first, second, last
    real(dp) :: kinetic, kick

    kick = s%kick_before + 0.5_dp*s%dt
    if (s%step == 0 .and. .not. s%method%half_start) kick = s%dt
    s%books%work_external = 0.0_dp
    s%removed_kinetic = 0.0_dp
    call move_walls(s%walls, s%time + 0.5_dp*s%dt)
    first = pass_t(flip=s%method%flip, dt=real(s%dt, wp), dt_strain=real(s%dt, wp), kick=real(kick, wp), time=s%time)
    last = first
    last%time = s%time + s%dt

    select case (s%method%scheme)
    case (usl)
      call nodal_stage(s, stage_full, kick)
      last%velocity = .true.; last%position = .true.; last%strain = .true.
    case (musl)
      call nodal_stage(s, stage_full, kick)
      first%velocity = .true.; first%momentum = .true.; first%old_weights = .true.
      call run_pass(s, first, error)
      if (allocated(error)) return
      call nodal_stage(s, stage_project, kick)
      last%position = .true.; last%moved_by_second = .true.; last%strain = .true.
    case (usf)
      call nodal_stage(s, stage_velocity, kick)
      first%strain = .true.; first%force = .true.; first%old_weights = .true.
      call run_pass(s, first, error)
      if (allocated(error)) return
      call nodal_stage(s, stage_kick, kick)
      last%velocity = .true.; last%position = .true.
    case (usavg)
      call nodal_stage(s, stage_velocity, kick)
      first%strain = .true.; first%force = .true.; first%old_weights = .true.; first%dt_strain = real(0.5_dp*s%dt, wp)
      call run_pass(s, first, error)
      if (allocated(error)) return
      call nodal_stage(s, stage_kick, kick)
      second = pass_t(flip=s%method%flip, kick=real(kick, wp), velocity=.true., momentum=.true., old_weights=.true.)
      call run_pass(s, second, error)
      if (allocated(error)) return
      call nodal_stage(s, stage_project, kick)
      last%position = .true.; last%moved_by_second = .true.; last%strain = .true.; last%dt_strain = real(0.5_dp*s%dt, wp)
    end select
    call finish_pass(s, last, error)
    if (allocated(error)) return

    kinetic = kinetic_given(s)
    call close_step(s%books, kinetic + s%removed_kinetic)
    s%books%kinetic = kinetic
    s%step = s%step + 1
    s%time = s%time + s%dt
    if (s%time_options%rule /= 1) s%time = s%step*s%time_options%step
    s%kick_before = 0.5_dp*s%dt
    s%particle_steps = s%particle_steps + s%engine%particles%n
    if (s%method%damping == damping_kinetic) call relax(s, kinetic, error)
  end subroutine advance

  !> The pass that brings particles to the grid for the next step
  pure type(pass_t) function give_pass(s, time)
    type(stepper_t), intent(in) :: s
    real(dp), intent(in) :: time
    give_pass%momentum = .true.
    give_pass%force = s%method%scheme == usl .or. s%method%scheme == musl
    give_pass%time = time
  end function give_pass

  !> Last pass of a step: take and give at once, or with a sort between when one is due
  subroutine finish_pass(s, last, error)
    type(stepper_t), intent(inout) :: s
    type(pass_t), intent(in) :: last
    type(error_t), allocatable, intent(out) :: error
    type(pass_t) :: give, both
    logical, allocatable :: leaving(:, :)
    logical :: removes
    removes = any(s%walls%side%removes)
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
    call run_pass(s, give, error)
  end subroutine finish_pass

  !> Run a pass, note its peaks and counts, and make an error of the worst particle's fate
  subroutine run_pass(s, pass, error)
    type(stepper_t), intent(inout) :: s
    type(pass_t), intent(in) :: pass
    type(error_t), allocatable, intent(out) :: error
    real(dp) :: start
    integer :: b
    start = seconds_now()
    call particle_pass(s%engine, pass)
    s%seconds(phase_particles) = s%seconds(phase_particles) + seconds_now() - start
    associate (engine => s%engine)
      if (any(engine%fate(1, :) /= fate_fine)) then
        b = findloc(engine%fate(1, :) /= fate_fine, .true., dim=1)
        call tell_fate(s, b, error)
        if (s%time_options%redo .and. all(engine%fate(1, :) == fate_fine .or. engine%fate(1, :) == fate_outside)) &
          s%hopeless = walked_out(s)
        return
      end if
      if (pass%force) s%rate = sqrt(maxval(engine%peaks(peak_rate, :)))
      if (pass%momentum) s%speed = sqrt(maxval(engine%peaks(peak_speed, :)))
      if (pass%strain) s%strain_rate = sqrt(maxval(engine%peaks(peak_strain, :)))
      call column_sums(engine%sums, s%sums)
      s%books%plastic = s%books%plastic + s%sums(sum_plastic)
      s%books%work_external = s%books%work_external + s%sums(sum_external)
      s%books%impulse = s%books%impulse + s%sums(sum_impulse:sum_impulse + 2)
      s%books%clamped = s%books%clamped + nint(s%sums(sum_clamped), i8)
      s%books%wide_chunks = s%books%wide_chunks + nint(s%sums(sum_wide), i8)
      s%books%spilled = s%books%spilled + engine%spill%n
      if (pass%momentum .or. pass%force) s%sort_now = s%sort_now .or. any(engine%restless)
    end associate
  end subroutine run_pass

  !> The message for a particle that went wrong
  subroutine tell_fate(s, b, error)
    type(stepper_t), intent(in) :: s
    integer, intent(in) :: b
    type(error_t), allocatable, intent(out) :: error
    character(len=:), allocatable :: where, why
    real(dp) :: x
    integer :: c, l, k
    c = s%engine%fate(2, b)
    l = s%engine%fate(3, b)
    where = ""
    do k = 1, s%engine%grid%dim
      x = s%engine%grid%lower(k) + s%engine%grid%spacing &
          *(real(s%engine%particles%p(l, k, c), dp) + s%engine%table%block_at(k, b)*s%engine%grid%edge(k))
      if (k > 1) where = where//","
      where = where//" "//text_of(x)
    end do
    select case (s%engine%fate(1, b))
    case (fate_inverted); why = "its deformation gradient has no positive determinant (the particle is inverted)"
    case (fate_outside)
      why = "it has left the grid"
      if (s%engine%grid%open_degree > 0) why = "it has left the box, where open-knot splines end (spline_boundary = 'ghost' goes on)"
    case (fate_jumped); why = "it moved by more than a block in one step"
    case default; why = "its position or deformation is not a number"
    end select
    call raise(error, "step "//text_of(s%step + 1)//", t = "//text_of(s%time)//" s, dt = "//text_of(s%dt)//" s: particle " &
               //text_of(s%engine%particles%id(l, c))//" at"//where//" m: "//why)
  end subroutine tell_fate

  !> Sort, and renew what hangs on the tables of blocks
  subroutine resort(s, leaving)
    type(stepper_t), intent(inout) :: s
    logical, intent(in), optional :: leaving(:, :)
    real(dp) :: start
    start = seconds_now()
    call sort_particles(s%engine, leaving)
    call find_held(s)
    s%sort_now = .false.
    s%books%sorts = s%books%sorts + 1
    s%seconds(phase_sort) = s%seconds(phase_sort) + seconds_now() - start
  end subroutine resort

  !> Slots with nodes that a side holds
  subroutine find_held(s)
    type(stepper_t), intent(inout) :: s
    integer :: slot
    if (allocated(s%held)) deallocate (s%held)
    allocate (s%held(s%engine%table%slots))
    !$omp parallel do schedule(static) if(s%engine%table%slots > few_blocks)
    do slot = 1, s%engine%table%slots
      s%held(slot) = walls_near(s%walls, s%engine%grid, s%engine%table%slot_at(:, slot))
    end do
    !$omp end parallel do
  end subroutine find_held

  !> Whether the particles that left the grid did so at less than a cell per step: then they go there with any step
  pure logical function walked_out(s)
    type(stepper_t), intent(in) :: s
    walked_out = s%dt*sqrt(maxval(s%engine%peaks(peak_speed, :))) < s%engine%grid%spacing
  end function walked_out

  !> Particles beyond a free side that takes material out; not allocated when there are none
  subroutine mark_leaving(s, leaving)
    type(stepper_t), intent(inout) :: s
    logical, allocatable, intent(out) :: leaving(:, :)
    logical, allocatable :: marks(:, :), marked(:)
    real(dp) :: x
    integer :: g, c, l, k
    associate (particles => s%engine%particles, grid => s%engine%grid)
      allocate (marks(lanes, particles%chunks), marked(size(particles%groups)), source=.false.)
      !$omp parallel do schedule(static) private(c, l, k, x) if(particles%chunks > few_chunks)
      do g = 1, size(particles%groups)
        do c = particles%groups(g)%first, particles%groups(g)%last
          do l = 1, lanes
            if (particles%id(l, c) == 0) cycle
            do k = 1, grid%dim
              x = real(particles%p(l, k, c), dp) + particles%groups(g)%at(k)*grid%edge(k)
              if (s%walls%side(1, k)%removes .and. x < 0.0_dp) marks(l, c) = .true.
              if (s%walls%side(2, k)%removes .and. x > grid%cells(k)) marks(l, c) = .true.
            end do
            marked(g) = marked(g) .or. marks(l, c)
          end do
        end do
      end do
      !$omp end parallel do
      do g = 1, size(particles%groups)
        if (.not. marked(g)) cycle
        do c = particles%groups(g)%first, particles%groups(g)%last
          do l = 1, lanes
            if (marks(l, c)) call book_removed(particles%groups(g)%material, c, l)
          end do
        end do
      end do
    end associate
    if (any(marked)) call move_alloc(marks, leaving)

  contains

    !> Kinetic and stored energy leave with the particle
    subroutine book_removed(material, chunk, lane)
      integer, intent(in) :: material, chunk, lane
      real(wp) :: f(lanes, 9), energy(lanes), history(lanes, most_states)
      real(dp) :: moving
      integer :: d, v
      d = s%engine%grid%dim
      call chunk_deformation(s%engine%particles, chunk, f)
      call chunk_history(s%engine%particles, chunk, history)
      v = s%engine%particles%velocity%first
      associate (p => s%engine%particles%p, particles => s%engine%particles)
        call s%engine%laws(material)%law%stored_energy(f, history, energy)
        moving = 0.5_dp*p(lane, particles%mass%first, chunk)*sum(p(lane, v:v + d - 1, chunk)**2)
        s%books%removed = s%books%removed + moving + p(lane, particles%volume%first, chunk)*energy(lane)
        s%removed_kinetic = s%removed_kinetic + moving
        s%books%impulse(:d) = s%books%impulse(:d) - p(lane, particles%mass%first, chunk)*p(lane, v:v + d - 1, chunk)
      end associate
      s%books%removed_particles = s%books%removed_particles + 1
    end subroutine book_removed

  end subroutine mark_leaving

  !> Nodes add their pads and obey the equation of motion
  subroutine nodal_stage(s, stage, kick)
    type(stepper_t), intent(inout) :: s
    integer, intent(in) :: stage
    real(dp), intent(in) :: kick
    type(node_step_t) :: step
    real(dp), allocatable :: part(:, :) ! (n_node_sums, slot): added in the order of slots
    real(dp) :: sums(n_node_sums), start
    real(wp) :: raw(nf, nodes_per_block)
    integer :: slot, lost
    logical :: loaded, at_once

    start = seconds_now()
    step = node_step_t(stage=stage, kick=real(kick, wp), gravity=real(gravity_at(s%loads, s%time), wp), cutoff=s%cutoff_mass, round_off=s%round_off_mass, &
                       pic=1.0_wp - s%method%flip)
    if (s%method%damping == damping_local) step%damping = s%method%damping_factor
    loaded = .false.
    if (stage == stage_full .or. stage == stage_kick) then
      call collect_loads(s%loads, s%engine, s%time)
      loaded = s%loads%n > 0
    end if
    at_once = .not. (loaded .or. s%engine%spill%n > 0 .or. has_images(s%engine%grid))
    allocate (part(n_node_sums, s%engine%table%slots))
    associate (engine => s%engine, table => s%engine%table)
      if (at_once) then
        !$omp parallel do schedule(dynamic, 16) private(raw) if(table%slots > few_blocks)
        do slot = 1, table%slots
          call sum_pads(engine, slot, raw)
          call update_nodes(step, engine%grid, s%walls, s%held(slot), table%slot_at(:, slot), raw, engine%g(:, :, slot), &
                            part(:, slot))
        end do
        !$omp end parallel do
      else
        if (allocated(s%raw)) then
          if (size(s%raw, 3) /= table%slots) deallocate (s%raw)
        end if
        if (.not. allocated(s%raw)) allocate (s%raw(nf, nodes_per_block, table%slots))
        !$omp parallel do schedule(dynamic, 16) if(table%slots > few_blocks)
        do slot = 1, table%slots
          call sum_pads(engine, slot, s%raw(:, :, slot))
        end do
        !$omp end parallel do
        call add_spills(engine, table%slots, s%raw)
        call remember_images(s, stage)
        call fold_images(engine%images, table%slots, s%raw)
        if (loaded) then
          lost = 0
          if (stage == stage_full) call copy_masses() ! the kick finds the masses there already
          call add_loads(s%loads, engine, table%slots, engine%g, s%cutoff_mass, s%raw, lost)
          s%books%lost_loads = s%books%lost_loads + lost
        end if
        !$omp parallel do schedule(static) if(table%slots > few_blocks)
        do slot = 1, table%slots
          call update_nodes(step, engine%grid, s%walls, s%held(slot), table%slot_at(:, slot), s%raw(:, :, slot), &
                            engine%g(:, :, slot), part(:, slot))
        end do
        !$omp end parallel do
        call copy_images(engine%images, table%slots, engine%g)
      end if
      if (loaded) s%books%impulse = s%books%impulse + kick*sum(s%loads%f(:, :s%loads%n), dim=2)
      if (loaded) s%books%work_external = s%books%work_external + work_of_loads(s%loads, engine, table%slots, engine%g, kick)
    end associate
    call column_sums(part, sums)
    sums(book_given) = sums(book_given) + s%sums(sum_affine) ! not a field of the nodes
    call book_stage(s%books, stage, kick, 1.0_dp - s%method%flip, sums)
    if (has_images(s%engine%grid) .and. (stage == stage_full .or. stage == stage_kick)) call book_images(s, kick)
    s%seconds(phase_grid) = s%seconds(phase_grid) + seconds_now() - start

  contains

    subroutine copy_masses()
      integer :: k
      !$omp parallel do schedule(static) if(s%engine%table%slots > few_blocks)
      do k = 1, s%engine%table%slots
        s%engine%g(node_mass, :, k) = s%raw(node_mass, :, k)
      end do
      !$omp end parallel do
    end subroutine copy_masses

  end subroutine nodal_stage

  !> Keep what images were given: momentum and mass from the first stage of a step, forces from the one that has them
  subroutine remember_images(s, stage)
    type(stepper_t), intent(inout) :: s
    integer, intent(in) :: stage
    real(wp) :: held(nf, size(s%engine%images))
    if (stage == stage_project) return
    call note_images(s%engine%images, s%engine%table%slots, s%raw, held)
    if (stage /= stage_kick) then
      s%at_images = held
    else
      s%at_images(5:7, :) = held(5:7, :)
    end if
  end subroutine remember_images

  !> A mirror turns around the normal momentum and force that its images were given, and what they give back: its reaction
  subroutine book_images(s, kick)
    type(stepper_t), intent(inout) :: s
    real(dp), intent(in) :: kick
    real(dp) :: impulse(3), part(3), pic
    integer :: k
    impulse = 0.0_dp
    pic = 1.0_dp - s%method%flip
    do k = 1, size(s%engine%images)
      associate (i => s%engine%images(k), given => s%at_images(:, k))
        associate (target => s%engine%g(:, i%target_place, i%target_slot))
          part = kick*given(5:7) + given(4)*target(5:7) + pic*(given(1:3) + given(4)*(target(1:3) - target(5:7)))
          impulse = impulse - (1.0_dp - i%sign(1:3))*part
        end associate
      end associate
    end do
    s%books%impulse = s%books%impulse + impulse
    s%books%reaction = s%books%reaction + impulse/kick
  end subroutine book_images

  !> Carry the sums of a stage into the books
  pure subroutine book_stage(books, stage, kick, pic, sums)
    type(books_t), intent(inout) :: books
    integer, intent(in) :: stage
    real(dp), intent(in) :: kick
    real(dp), intent(in) :: pic !! share of PIC: only so much of the held velocity reaches the particles
    real(dp), intent(in) :: sums(n_node_sums)
    if (stage == stage_full .or. stage == stage_velocity) then
      books%given = sums(book_given)
      books%work_pushed = pic*sums(book_pushed)
      books%cut_nodes = books%cut_nodes + nint(sums(book_cut), kind(books%cut_nodes))
      books%cut_momentum = books%cut_momentum + sums(book_cut_momentum)
      if (stage == stage_velocity) books%impulse = books%impulse + sums(book_impulse:book_impulse + 2)
      books%reaction = pic*sums(book_held:book_held + 2)/kick
      books%impulse = books%impulse + pic*sums(book_held:book_held + 2)
    end if
    if (stage == stage_full .or. stage == stage_kick) then
      books%grid_before = sums(book_before)
      books%grid_after = sums(book_after)
      books%work_forces = sums(book_forces)
      books%work_gravity = sums(book_gravity)
      books%work_walls = sums(book_walls)
      books%work_damping = sums(book_damping)
      books%reaction = books%reaction + sums(book_reaction:book_reaction + 2)/kick
      books%impulse = books%impulse + sums(book_reaction:book_reaction + 2) + sums(book_impulse:book_impulse + 2)
    end if
  end subroutine book_stage

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
    call run_pass(s, give_pass(s, s%time), error)
  end subroutine relax

end module gimp_stepper
