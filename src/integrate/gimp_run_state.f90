!> A run in progress: everything that steps read and change, and what follows from it at a glance
!>
!> The components of `stepper_t` from `held` on belong to the modules of this room; other rooms leave them alone.
module gimp_run_state
  use gimp_kinds, only: wp, dp, i8
  use gimp_parcel, only: parcel_t, carry, carry_bits
  use gimp_over_ranks, only: sum_columns, largest_reals, smallest_reals
  use gimp_blocks, only: few_blocks
  use gimp_particles, only: few_chunks
  use gimp_basis, only: basis_ddmp
  use gimp_engine, only: engine_t, engine_bytes, n_sums, sum_kinetic, sum_affine
  use gimp_walls, only: walls_t, walls_near, side_free
  use gimp_loads, only: loads_t
  use gimp_books, only: books_t
  use gimp_step_size, only: time_options_t
  use gimp_saved_state, only: saved_state_t, saved_bytes
  implicit none(type, external)
  private
  public :: stepper_t, method_t, hands_on, carry_stepper, stepper_bytes, set_bounds, find_held, kinetic_given, momentum_of, weigh
  public :: in_series, flip_now, series_none, series_xpic, series_fmpm, position_grid, position_published, position_new
  public :: symplectic, generalized_alpha, newmark, integrator_of_word
  public :: power_forces, power_gravity, power_walls, power_damping, power_external, power_lost, n_powers
  public :: usf, usl, musl, usavg, scheme_of_word, damping_none, damping_local, damping_kinetic
  public :: phase_grid, phase_particles, phase_sort, phase_checks, n_phases

  integer, parameter :: usf = 1, usl = 2, musl = 3, usavg = 4
  integer, parameter :: symplectic = 1, generalized_alpha = 2, newmark = 3
  !> Powers that Newmark's kicks are booked by
  integer, parameter :: power_forces = 1, power_gravity = 2, power_walls = 3, power_damping = 4, power_external = 5, &
    power_lost = 6, n_powers = 6
  integer, parameter :: damping_none = 0, damping_local = 1, damping_kinetic = 2
  integer, parameter :: series_none = 0, series_xpic = 1, series_fmpm = 2
  integer, parameter :: position_grid = 1 !! x' = x + dt S v+
  integer, parameter :: position_published = 2 !! XPIC: x + dt (S v + (v' - v)/2), FMPM: x + dt (v + v')/2
  integer, parameter :: position_new = 3 !! x' = x + dt v'
  integer, parameter :: phase_grid = 1, phase_particles = 2, phase_sort = 3, n_phases = 4
  integer, parameter :: phase_checks = 4 !! critical step, and the copy of the state for steps that may be redone

  !> How a step is taken
  type :: method_t
    integer :: integrator = symplectic
    real(wp) :: spectral_radius = 0.8_wp !! generalised alpha: at the bifurcation
    real(wp) :: newmark_gamma = 0.5_wp
    integer :: scheme = musl
    real(wp) :: flip = 1.0_wp !! share of FLIP in the velocity transfer; 0 is PIC
    real(wp) :: cutoff = 1.0e-12_wp !! mass cut-off, in units of the largest particle mass
    real(wp) :: redistribute = 0.0_wp !! nodes below this share of the mass of a full cell hand on force; 0: none
    logical :: half_start = .true. !! the first kick covers half a step, so that velocities live at half steps
    integer :: damping = damping_none
    real(wp) :: damping_factor = 0.7_wp
    integer :: sort_every = 0 !! steps; 0: when needed
    integer :: filter_every = 0 !! steps between null-space filters of the velocities; 0: none
    integer :: series = series_none !! XPIC or FMPM (gimp_series); `flip` is for the steps without
    integer :: order = 1 !! terms of it
    integer :: series_every = 1 !! steps from one to the next
    integer :: position = position_grid !! what moves particles in a step with the series
    logical :: strain_by_series = .false. !! strains, too, come from the velocity of that order
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
    real(wp) :: light_mass = 0.0_wp !! nodes below it hand on force [kg]
    integer(i8) :: particle_steps = 0
    real(dp) :: seconds(n_phases) = 0.0_dp
    ! for this room only
    logical, allocatable :: held(:) !! (slot) touched by a side of the box
    real(wp), allocatable :: raw(:, :, :) !! sums of pads, when images, loads or spills need them all at once
    real(wp), allocatable :: memory(:, :, :) !! a second such array, of generalised alpha (two accelerations) and Newmark (forces)
    real(dp) :: power(2, n_powers) = 0.0_dp !! Newmark: of what forces do with velocities [W] and accelerations [W/s] of the particles
    real(dp) :: pull(3) = 0.0_dp !! Newmark: all forces from outside [N]
    real(wp), allocatable :: at_images(:, :) !! (field, image) given to images before they were folded
    real(wp), allocatable :: star(:, :, :) !! (axis, node of block, slot) series of XPIC and FMPM so far [m/s]
    real(dp), allocatable :: star_impulse(:, :) !! (2 axes, slot) what a term of it loses to cut nodes and gets from sides [kg m/s]
    logical :: sort_now = .false.
    real(dp) :: sums(n_sums) = 0.0_dp !! of all blocks over the last pass
    real(dp) :: kinetic_peak = 0.0_dp
    real(dp) :: removed_kinetic = 0.0_dp !! left with particles in this step [J]
    type(saved_state_t) :: saved !! start of the step in hand, if steps may be redone
    real(dp) :: stored = 0.0_dp !! elastic energy now, if steps may be redone [J]
    real(dp) :: energy_noise = 0.0_dp !! round-off of that [J]
    logical :: hopeless = .false. !! the step failed in a way that a shorter one does not cure
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

  !> Whether the step in hand takes particle velocities from the series of XPIC or FMPM
  pure logical function in_series(s)
    type(stepper_t), intent(in) :: s
    in_series = .false.
    if (s%method%series /= series_none) in_series = modulo(s%step, int(s%method%series_every, i8)) == 0
  end function in_series

  !> Share of FLIP in the velocity transfer of the step in hand: the series keeps nothing of the old particle velocities
  pure real(wp) function flip_now(s)
    type(stepper_t), intent(in) :: s
    flip_now = s%method%flip
    if (in_series(s)) flip_now = 0.0_wp
  end function flip_now

  !> Number of an integrator from its word, 0 for none
  pure integer function integrator_of_word(word) result(integrator)
    character(len=*), intent(in) :: word
    select case (word)
    case ("symplectic"); integrator = symplectic
    case ("generalized_alpha"); integrator = generalized_alpha
    case ("newmark"); integrator = newmark
    case default; integrator = 0
    end select
  end function integrator_of_word

  !> Whether light nodes hand on force
  pure logical function hands_on(method)
    type(method_t), intent(in) :: method
    hands_on = method%redistribute > 0.0_wp
  end function hands_on

  !> Bytes in use: the engine's, and those of the state that steps may be redone from
  pure integer(i8) function stepper_bytes(s)
    type(stepper_t), intent(in) :: s
    stepper_bytes = engine_bytes(s%engine) + saved_bytes(s%saved)
  end function stepper_bytes

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
    call carry(parcel, s%light_mass)
    call carry(parcel, s%particle_steps)
    do k = 1, n_phases
      call carry(parcel, s%seconds(k))
    end do
    do k = 1, n_sums
      call carry(parcel, s%sums(k))
    end do
    call carry(parcel, s%sort_now)
    call carry(parcel, s%kinetic_peak)
    do k = 1, n_powers
      call carry(parcel, s%power(1, k))
      call carry(parcel, s%power(2, k))
    end do
    do k = 1, 3
      call carry(parcel, s%pull(k))
    end do
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
      if (s%engine%basis == basis_ddmp) then ! and so do the smeared rows
        if (.not. (s%engine%grid%periodic(k) .or. s%engine%grid%mirror_low(k))) s%engine%allowed_low(k) = 0.0_wp
        if (.not. (s%engine%grid%periodic(k) .or. s%engine%grid%mirror_high(k))) s%engine%allowed_high(k) = s%engine%grid%cells(k)
      end if
    end do
  end subroutine set_bounds

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
    call sum_columns(part, momentum)
  end function momentum_of

  !> Mass of all particles and of the heaviest one [kg]
  subroutine weigh(s, mass, heaviest, lightest_density)
    type(stepper_t), intent(in) :: s
    real(dp), intent(out) :: mass
    real(wp), intent(out) :: heaviest
    real(wp), intent(out) :: lightest_density !! least mass over volume before deformation [kg/m3]
    real(dp), allocatable :: part(:, :) ! (1, group)
    real(dp) :: sums(1), extreme(1)
    integer :: g, c
    allocate (part(1, size(s%engine%particles%groups)), source=0.0_dp)
    heaviest = 0.0_wp
    lightest_density = huge(1.0_wp)
    associate (particles => s%engine%particles)
      !$omp parallel do schedule(static) private(c) reduction(max:heaviest) reduction(min:lightest_density) if(particles%chunks > few_chunks)
      do g = 1, size(particles%groups)
        do c = particles%groups(g)%first, particles%groups(g)%last
          part(1, g) = part(1, g) + sum(real(particles%p(:, particles%mass%first, c), dp))
          heaviest = max(heaviest, maxval(particles%p(:, particles%mass%first, c)))
          lightest_density = min(lightest_density, minval(particles%p(:, particles%mass%first, c) &
            /max(tiny(1.0_wp), particles%p(:, particles%volume%first, c)), mask=particles%id(:, c) > 0))
        end do
      end do
      !$omp end parallel do
    end associate
    call sum_columns(part, sums)
    mass = sums(1)
    extreme = heaviest
    call largest_reals(extreme)
    heaviest = real(extreme(1), wp)
    extreme = lightest_density
    call smallest_reals(extreme)
    lightest_density = real(extreme(1), wp)
  end subroutine weigh

end module gimp_run_state
