!> The books close to round-off: energy and momentum of bodies that vibrate, fall, hit sides, are loaded, damped and removed
program test_books
  use gimp_kinds, only: wp, dp, lanes
  use gimp_basis, only: basis_linear, basis_ugimp, basis_cpgimp
  use gimp_domains, only: domain_stretch
  use gimp_error, only: error_t
  use gimp_books, only: books_t, energy_residual, momentum_residual, close_step
  use gimp_run_state, only: stepper_t, usf, usl, musl, usavg, generalized_alpha, newmark, damping_local, damping_kinetic
  use gimp_stepper, only: start_run, plan_step, take_step
  use gimp_step_size, only: rule_fixed
  use gimp_walls, only: side_slip, side_stick, side_velocity, side_periodic, set_walls
  use gimp_loads, only: load_pressure
  use gimp_engine_fixture, only: cloud_t, lattice_cloud, make_engine, read_cloud
  use gimp_text, only: text_of
  use gimp_check, only: begin_suite, end_suite, check, check_true
  implicit none(type, external)

  real(wp), parameter :: spacing = 0.1_wp, dt = 0.004_wp
  integer :: scheme, basis

  call begin_suite("books")
  call test_close_step()
  do scheme = -newmark, usavg
    if (scheme < usf .and. scheme > -generalized_alpha) cycle
    do basis = basis_linear, basis_cpgimp
      call test_free_body(scheme, basis)
    end do
    call test_falling_on_sides(scheme, 1.0_wp)
    if (scheme > 0) call test_falling_on_sides(scheme, 0.9_wp)
    call test_periodic_gravity(scheme, 1.0_wp)
    call test_periodic_gravity(scheme, -1.0_wp)
    call test_load(scheme)
  end do
  call test_body_in_space()
  call test_kinetic_damping()
  call test_removal()
  call end_suite()

contains

  !> A step with made-up works: the residual is what the identity leaves
  subroutine test_close_step()
    type(books_t) :: books
    books%kinetic = 10.0_dp
    books%given = 10.0_dp
    books%grid_before = 9.5_dp
    books%grid_after = 12.0_dp
    books%work_forces = 2.0_dp
    books%work_gravity = 0.5_dp
    call close_step(books, 11.75_dp)
    call check(real(books%residual, wp), 0.0_wp, 1.0e-14_wp, "a step whose works are what nodes gained closes")
    call check(real(books%loss_p2g, wp), 0.5_wp, 1.0e-14_wp, "lost on the way to the grid")
    call check(real(books%loss_g2p, wp), 0.25_wp, 1.0e-14_wp, "and on the way back")
    books%grid_before = 11.0_dp
    books%given = 11.75_dp
    books%grid_after = 14.0_dp ! nodes gained 3, works say 2.5
    call close_step(books, 13.0_dp)
    call check(real(books%residual, wp), 0.5_wp, 1.0e-14_wp, "a gain that nobody worked for shows")
    call check(real(energy_residual(books), wp), 0.5_wp/13.0_wp, 1.0e-14_wp, "as a share of the largest energy")
  end subroutine test_close_step

  !> A body in the middle of the box, strained and with a velocity field: it flies, turns and vibrates
  subroutine vibrating(dim, basis, scheme, s, cloud, faces)
    integer, intent(in) :: dim, basis, scheme !! below 0: an integrator
    type(stepper_t), intent(out) :: s
    type(cloud_t), intent(out) :: cloud
    logical, intent(in), optional :: faces
    integer :: i
    call lattice_cloud(dim, [5, 5, 5], merge([3, 3, 3], [4, 3, 1], dim == 3), 2, spacing, 1000.0_wp, cloud)
    do i = 1, cloud%n
      cloud%x(:dim, i) = cloud%x(:dim, i) + 0.117_wp
      cloud%v(1, i) = 0.3_wp + 0.1_wp*sin(2.0_wp*cloud%x(2, i))
      if (dim > 1) cloud%v(2, i) = -0.2_wp + 0.1_wp*cos(2.0_wp*cloud%x(1, i))
      if (dim > 2) cloud%v(3, i) = 0.1_wp*cloud%x(1, i) - 0.6_wp
      cloud%f(1, i) = 1.05_wp
      if (dim > 1) cloud%f(2, i) = 0.03_wp
    end do
    call make_engine(dim, basis, merge([14, 14, 14], [1, 1, 1], [1, 2, 3] <= dim), spacing, cloud, s%engine, with_faces=faces, &
                     acceleration=scheme < 0)
    if (basis == basis_cpgimp) s%engine%domain_rule = domain_stretch
    call choose(s, scheme)
    s%method%cutoff = 0.0_wp ! a node that is cut holds momentum back
    s%time_options%rule = rule_fixed
    s%time_options%step = dt
  end subroutine vibrating

  !> A scheme of the symplectic step, or (below 0) another integrator
  subroutine choose(s, scheme)
    type(stepper_t), intent(inout) :: s
    integer, intent(in) :: scheme
    s%method%scheme = merge(usl, scheme, scheme < 0)
    if (scheme < 0) s%method%integrator = -scheme
  end subroutine choose

  subroutine run(s, steps, what)
    type(stepper_t), intent(inout) :: s
    integer, intent(in) :: steps
    character(len=*), intent(in) :: what
    type(error_t), allocatable :: error
    integer :: k
    if (s%step == 0) call start_run(s, error)
    do k = 1, steps
      if (.not. allocated(error)) call plan_step(s, 1.0e9_wp, error)
      if (.not. allocated(error)) call take_step(s, error)
    end do
    if (allocated(error)) print "(a)", error%message
    call check_true(.not. allocated(error), what//": the run goes through")
  end subroutine run

  function momentum_of(cloud) result(momentum)
    type(cloud_t), intent(in) :: cloud
    real(wp) :: momentum(3)
    momentum = matmul(cloud%v, cloud%mass)
  end function momentum_of

  !> Residuals after the run: energy below 1e-12 of the largest energy, momentum below 1e-13 of the largest (60 steps of
  !> round-off of sums over some hundred nodes)
  subroutine check_books(s, what)
    type(stepper_t), intent(in) :: s
    character(len=*), intent(in) :: what
    type(cloud_t) :: after
    call read_cloud(s%engine, after)
    call check(real(energy_residual(s%books), wp), 0.0_wp, 1.0e-12_wp, what//": energy residual")
    call check(real(momentum_residual(s%books, real(momentum_of(after), dp)), wp), 0.0_wp, 1.0e-13_wp, what//": momentum residual")
    call check_true(s%books%largest > 0.1_dp, what//": there was energy")
  end subroutine check_books

  !> Nothing from outside: momentum of the particles themselves stays to 1e-13 of sum m |v|
  subroutine test_free_body(scheme, basis)
    integer, intent(in) :: scheme, basis
    type(stepper_t) :: s
    type(cloud_t) :: cloud, after
    character(len=:), allocatable :: which
    which = "free body, scheme "//text_of(scheme)//", basis "//text_of(basis)
    call vibrating(2, basis, scheme, s, cloud)
    call run(s, 60, which)
    call check_books(s, which)
    call read_cloud(s%engine, after)
    call check(maxval(abs(momentum_of(after) - momentum_of(cloud))), 0.0_wp, &
               1.0e-13_wp*sum(cloud%mass*sqrt(sum(cloud%v**2, 1))), which//": momentum")
    call check_true(abs(s%books%internal) > 1.0e-3_dp, which//": forces did work")
    call check(real(abs(s%books%loads) + abs(s%books%reactions), wp), 0.0_wp, 0.0_wp, which//": nothing from outside")
  end subroutine test_free_body

  !> Gravity, a sticky floor, a slippery wall, a driven one, local damping: all at once, FLIP and a blend with PIC
  subroutine test_falling_on_sides(scheme, flip)
    integer, intent(in) :: scheme
    real(wp), intent(in) :: flip
    type(stepper_t) :: s
    type(cloud_t) :: cloud
    character(len=:), allocatable :: which
    which = "sides, scheme "//text_of(scheme)//", flip "//text_of(flip)
    call vibrating(2, basis_cpgimp, scheme, s, cloud)
    s%method%flip = flip
    s%method%damping = damping_local
    s%method%damping_factor = 0.2_wp
    s%walls%side(1, 2)%condition = side_stick
    s%walls%side(2, 1)%condition = side_slip
    s%walls%side(1, 1)%condition = side_velocity
    s%walls%side(1, 1)%velocity = [0.4_wp, 0.0_wp, 0.0_wp]
    allocate (s%loads%gravity(1), s%loads%load(0))
    s%loads%gravity(1)%acceleration = [4.0_wp, -6.0_wp, 0.0_wp]
    call run(s, 130, which)
    call check_books(s, which)
    call check_true(s%books%loads > 0.1_dp, which//": gravity did work")
    call check_true(s%books%damping > 0.0_dp, which//": damping took some")
    call check_true(s%books%reaction(2) > 0.0_dp, which//": the floor carries")
  end subroutine test_falling_on_sides

  !> A body that falls in a box without sides, over the seam: the work of gravity is the kinetic energy, counted once also
  !> where nodes have images. It falls more than a turn either way, whatever the blocks that the seam cuts (14 cells, blocks of 8)
  subroutine test_periodic_gravity(scheme, way)
    integer, intent(in) :: scheme
    real(wp), intent(in) :: way
    type(stepper_t) :: s
    type(cloud_t) :: cloud, after
    real(wp) :: kinetic
    character(len=:), allocatable :: which
    which = "periodic fall, scheme "//text_of(scheme)//", way "//text_of(way)
    call lattice_cloud(2, [10, 10, 0], [3, 3, 1], 2, spacing, 1000.0_wp, cloud)
    call make_engine(2, basis_ugimp, [14, 14, 1], spacing, cloud, s%engine, acceleration=scheme < 0)
    call choose(s, scheme)
    s%time_options%rule = rule_fixed
    s%time_options%step = dt
    s%walls%side(:, 1)%condition = side_periodic
    s%walls%side(:, 2)%condition = side_periodic
    call set_walls(s%walls, s%engine%grid)
    allocate (s%loads%gravity(1), s%loads%load(0))
    s%loads%gravity(1)%acceleration = way*[20.0_wp, 16.0_wp, 0.0_wp]
    call run(s, 120, which)
    call read_cloud(s%engine, after)
    kinetic = 0.5_wp*sum(after%mass*sum(after%v**2, 1))
    call check(real(s%books%loads, wp), kinetic, 1.0e-11_wp*kinetic, which//": work of gravity")
    call check(real(abs(s%books%reactions), wp), 0.0_wp, 1.0e-12_wp*kinetic, which//": there are no sides")
    call check(real(abs(s%books%loss_p2g) + abs(s%books%loss_g2p), wp), 0.0_wp, 1.0e-11_wp*kinetic, which//": nothing is lost")
    call check_books(s, which)
  end subroutine test_periodic_gravity

  !> A pressure on the middle of one face pushes the body through the grid
  subroutine test_load(scheme)
    integer, intent(in) :: scheme
    type(stepper_t) :: s
    type(cloud_t) :: cloud
    integer :: c, l
    character(len=:), allocatable :: which
    which = "pressure, scheme "//text_of(scheme)
    call vibrating(2, basis_cpgimp, scheme, s, cloud, faces=.true.)
    do c = 1, s%engine%particles%chunks
      do l = 1, lanes
        if (s%engine%particles%id(l, c) == 0) cycle
        if (abs(cloud%x(2, int(s%engine%particles%id(l, c))) - 6.5_wp) > 1.1_wp) cycle
        if (cloud%x(1, int(s%engine%particles%id(l, c))) > 5.5_wp) cycle
        s%engine%particles%p(l, s%engine%particles%faces%first, c) = 1.0_wp
      end do
    end do
    allocate (s%loads%gravity(0), s%loads%load(1))
    s%loads%load(1)%kind = load_pressure
    s%loads%load(1)%pressure = 40.0_wp
    call run(s, 60, which)
    call check_true(abs(s%books%loads) > 0.01_dp, which//": the pressure did work")
    call check(int(s%books%lost_loads), 0, which//": no corner lies on a node that does not exist")
    call check_books(s, which)
  end subroutine test_load

  subroutine test_body_in_space()
    type(stepper_t) :: s
    type(cloud_t) :: cloud
    call vibrating(3, basis_cpgimp, musl, s, cloud)
    call run(s, 25, "free body in space")
    call check_books(s, "free body in space")
  end subroutine test_body_in_space

  !> Kinetic damping: energy only falls at the resets, which the books have
  subroutine test_kinetic_damping()
    type(stepper_t) :: s
    type(cloud_t) :: cloud
    call vibrating(2, basis_cpgimp, usl, s, cloud)
    s%engine%particles%p(:, s%engine%particles%velocity%first:s%engine%particles%velocity%first + 1, :) = 0.0_wp
    s%method%damping = damping_kinetic
    call run(s, 200, "kinetic damping")
    call check_true(s%books%damping > 1.0e-2_dp, "kinetic energy was taken out at its maxima")
    call check(real(energy_residual(s%books), wp), 0.0_wp, 1.0e-12_wp, "kinetic damping: energy residual")
  end subroutine test_kinetic_damping

  !> Material that leaves through a free side takes its mass, momentum and energy with it
  subroutine test_removal()
    type(stepper_t) :: s
    type(cloud_t) :: cloud
    real(dp) :: mass
    call vibrating(2, basis_cpgimp, musl, s, cloud)
    s%engine%particles%p(:, 1, :) = s%engine%particles%p(:, 1, :) + 4.5_wp
    s%walls%side(2, 1)%removes = .true.
    call run(s, 80, "removal")
    call check_true(s%books%removed_particles > 0, "some particles left")
    call check(int(s%engine%particles%n + s%books%removed_particles), cloud%n, "all others are there")
    call check(real(energy_residual(s%books), wp), 0.0_wp, 1.0e-12_wp, "removal: energy residual")
    call check_true(s%books%removed > 0.0_dp, "energy went with them")
    mass = sum(s%engine%particles%p(:, s%engine%particles%mass%first, :))
    call check(real(mass, wp), sum(cloud%mass)*s%engine%particles%n/cloud%n, 1.0e-12_wp*sum(cloud%mass), "and their mass")
  end subroutine test_removal

end program test_books
