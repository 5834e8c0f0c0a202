!> A step that goes wrong leaves no trace: what is redone has the bits of a run that took the shorter step at once
program test_redo
  use gimp_kinds, only: wp
  use gimp_basis, only: basis_linear, basis_cpgimp
  use gimp_domains, only: domain_stretch
  use gimp_engine, only: affine_none, affine_apic
  use gimp_error, only: error_t
  use gimp_step_size, only: limit_word, most_halvings
  use gimp_run_state, only: stepper_t, stepper_bytes, usf, usl, musl, usavg, damping_kinetic
  use gimp_stepper, only: start_run, take_step
  use gimp_walls, only: side_periodic, side_symmetry, set_walls
  use gimp_engine_fixture, only: cloud_t, lattice_cloud, make_engine, read_cloud
  use gimp_particles, only: live_bytes
  use gimp_text, only: text_of
  use gimp_check, only: begin_suite, end_suite, check, check_true
  use omp_lib, only: omp_set_num_threads
  implicit none(type, external)

  real(wp), parameter :: spacing = 0.1_wp
  integer :: scheme

  call omp_set_num_threads(1)
  call begin_suite("redo")
  do scheme = usf, usavg
    call test_no_trace(basis_cpgimp, scheme, affine_none, 0, "plain")
  end do
  call test_no_trace(basis_cpgimp, musl, affine_apic, 1, "apic, with a sort in the step")
  call test_no_trace(basis_linear, usl, affine_none, 1, "tents, with a sort in the step")
  call test_no_trace(basis_cpgimp, musl, affine_none, 1, "periodic")
  call test_no_trace(basis_cpgimp, musl, affine_none, 0, "mirror")
  call test_no_trace(basis_cpgimp, musl, affine_none, 0, "damping")
  call test_no_trace(basis_cpgimp, musl, affine_none, 0, "leaving")
  call test_jump()
  call test_given_up()
  call test_walking_out()
  call test_bytes()
  call end_suite()

contains

  !> A body of 4 x 3 cells that shakes and flies
  subroutine shaken(basis, scheme, affine, sort_every, which, redo, s)
    integer, intent(in) :: basis, scheme, affine, sort_every
    character(len=*), intent(in) :: which
    logical, intent(in) :: redo
    type(stepper_t), intent(out) :: s
    type(cloud_t) :: cloud
    type(error_t), allocatable :: error
    integer :: i
    call lattice_cloud(2, [10, 9, 0], [4, 3, 1], 2, spacing, 1000.0_wp, cloud)
    cloud%x(1, :) = cloud%x(1, :) + 0.117_wp
    if (which == "mirror") cloud%x(1, :) = cloud%x(1, :) - 10
    cloud%v(1, :) = 0.2_wp + [(0.5_wp*sin(3.1_wp*i), i=1, cloud%n)]
    cloud%v(2, :) = [(0.5_wp*cos(4.3_wp*i), i=1, cloud%n)]
    if (affine == affine_none) then
      call make_engine(2, basis, [24, 24, 1], spacing, cloud, s%engine)
    else
      call make_engine(2, basis, [24, 24, 1], spacing, cloud, s%engine, affine=affine)
    end if
    if (basis == basis_cpgimp) s%engine%domain_rule = domain_stretch
    if (which == "periodic") s%walls%side(:, 1)%condition = side_periodic
    if (which == "mirror") s%walls%side(1, 1)%condition = side_symmetry
    if (which == "damping") s%method%damping = damping_kinetic
    if (which == "leaving") s%walls%side(2, 1)%removes = .true.
    call set_walls(s%walls, s%engine%grid)
    s%method%scheme = scheme
    s%method%flip = 0.95_wp
    s%method%sort_every = sort_every
    s%time_options%redo = redo
    allocate (s%loads%gravity(1), s%loads%load(0))
    s%loads%gravity(1)%acceleration = [0.0_wp, -1.0_wp, 0.0_wp]
    call start_run(s, error)
    call check_true(.not. allocated(error), "the run starts")
  end subroutine shaken

  !> Steps of which some are far too long; a second run without redo takes the lengths that the first one came to
  subroutine test_no_trace(basis, scheme, affine, sort_every, which)
    integer, intent(in) :: basis, scheme, affine, sort_every
    character(len=*), intent(in) :: which
    integer, parameter :: steps = 12
    type(stepper_t) :: first, second
    type(cloud_t) :: a, b
    type(error_t), allocatable :: error
    real(wp) :: dt(steps)
    integer :: k
    character(len=:), allocatable :: words
    words = which//", scheme "//text_of(scheme)
    call shaken(basis, scheme, affine, sort_every, which, .true., first)
    do k = 1, steps
      first%dt = merge(0.6_wp, 0.02_wp, modulo(k, 4) == 2)
      if (.not. allocated(error)) call take_step(first, error)
      dt(k) = first%dt
    end do
    if (allocated(error)) print "(a)", error%message
    call check_true(.not. allocated(error), "the run with redone steps goes through: "//words)
    call check_true(first%redone_steps >= steps/4, "long steps are redone: "//words)
    call check_true(first%halvings >= first%redone_steps, "halvings are counted: "//words)
    call check(limit_word(8), "redone", "what set the step has a name")
    call check(int(first%step), steps, "steps are counted once: "//words)
    call shaken(basis, scheme, affine, sort_every, which, .false., second)
    do k = 1, steps
      second%dt = dt(k)
      if (.not. allocated(error)) call take_step(second, error)
    end do
    call check_true(.not. allocated(error), "the run with short steps goes through: "//words)
    if (allocated(error)) return
    call read_cloud(first%engine, a)
    call read_cloud(second%engine, b)
    call check_true(all(a%x == b%x) .and. all(a%v == b%v) .and. all(a%f == b%f), "no trace in the particles: "//words)
    call check_true(first%time == second%time .and. first%particle_steps == second%particle_steps .and. &
                    first%rate == second%rate .and. first%speed == second%speed, "nor in the clock: "//words)
    call check_true(first%books%residual == second%books%residual .and. all(first%books%impulse == second%books%impulse) .and. &
                    first%books%internal == second%books%internal .and. first%books%loss_g2p == second%books%loss_g2p .and. &
                    first%books%largest == second%books%largest .and. first%books%clamped == second%books%clamped .and. &
                    first%books%wide_chunks == second%books%wide_chunks .and. first%books%sorts == second%books%sorts .and. &
                    first%books%removed == second%books%removed .and. first%books%damping == second%books%damping, &
                    "nor in the books: "//words)
  end subroutine test_no_trace

  !> A body without stress that would jump over more than a block of eight cells
  subroutine test_jump()
    type(stepper_t) :: s
    type(error_t), allocatable :: error
    call flying([-1.0_wp, 0.0_wp, 0.0_wp], s)
    s%dt = 2.0_wp ! 20 cells from the middle of a block; 5 are within the next one
    call take_step(s, error)
    call check_true(.not. allocated(error), "a jump is redone")
    call check(s%dt, 0.5_wp, 0.0_wp, "with a quarter of the step")
    call check(s%time, 0.5_wp, 0.0_wp, "and the clock says so")
  end subroutine test_jump

  subroutine flying(velocity, s)
    real(wp), intent(in) :: velocity(3)
    type(stepper_t), intent(out) :: s
    type(cloud_t) :: cloud
    type(error_t), allocatable :: error
    call lattice_cloud(2, [30, 9, 0], [3, 3, 1], 2, spacing, 1000.0_wp, cloud)
    cloud%v = spread(velocity, 2, cloud%n)
    call make_engine(2, basis_linear, [36, 24, 1], spacing, cloud, s%engine)
    s%time_options%redo = .true.
    call start_run(s, error)
    call check_true(.not. allocated(error), "the run starts")
  end subroutine flying

  !> Nothing helps a step that is a thousand times too long: the failure is told, with what was tried
  subroutine test_given_up()
    type(stepper_t) :: s
    type(error_t), allocatable :: error
    call flying([-1.0_wp, 0.0_wp, 0.0_wp], s)
    s%dt = 1.2e3_wp
    call take_step(s, error)
    call check_true(allocated(error), "the step fails in the end")
    if (.not. allocated(error)) return
    call check_true(index(error%message, "halved "//text_of(most_halvings)//" times") > 0, "and says what was tried")
    call check(int(s%halvings), most_halvings, "halvings are counted")
  end subroutine test_given_up

  !> A particle that leaves the grid at its own pace would do so with any step
  subroutine test_walking_out()
    type(stepper_t) :: s
    type(error_t), allocatable :: error
    integer :: k
    call flying([1.0_wp, 0.0_wp, 0.0_wp], s)
    do k = 1, 20
      s%dt = 0.03_wp
      if (.not. allocated(error)) call take_step(s, error)
    end do
    call check_true(allocated(error), "the body leaves the grid")
    if (allocated(error)) call check_true(index(error%message, "left the grid") > 0, "and that is what is told")
    call check(int(s%halvings), 0, "nothing is redone")
  end subroutine test_walking_out

  !> The copy costs what a particle costs, and nothing when it is not asked for
  subroutine test_bytes()
    type(stepper_t) :: with, without
    integer :: lanes_with
    call shaken(basis_cpgimp, musl, affine_none, 0, "plain", .true., with)
    call shaken(basis_cpgimp, musl, affine_none, 0, "plain", .false., without)
    lanes_with = size(with%engine%particles%id)
    call check(int(stepper_bytes(with) - stepper_bytes(without)), lanes_with*live_bytes(with%engine%particles), "bytes of the copy")
  end subroutine test_bytes

end program test_redo
