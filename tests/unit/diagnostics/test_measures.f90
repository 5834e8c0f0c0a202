!> Totals against plain sums, errors that vanish for the exact state, and a hash that sees every bit and no order
program test_measures
  use gimp_kinds, only: wp, dp, i8, lanes
  use gimp_basis, only: basis_ugimp, basis_cpgimp
  use gimp_engine, only: engine_t
  use gimp_resort, only: sort_particles
  use gimp_error, only: error_t
  use gimp_verification, only: verification_t, verification_options_t, make_verification, exact_motion
  use gimp_measures, only: totals_t, errors_t, measure_totals, measure_errors, state_hash, chunk_position, chunk_stress, &
    find_particle, nearest_particle
  use gimp_engine_fixture, only: cloud_t, random_cloud, lattice_cloud, make_engine
  use gimp_text, only: text_of
  use gimp_check, only: begin_suite, end_suite, check, check_true
  implicit none(type, external)

  integer :: seed = 12, dim

  call begin_suite("measures")
  do dim = 1, 3
    call test_totals(dim)
    call test_errors(dim)
  end do
  call test_hash()
  call test_find()
  call end_suite()

contains

  subroutine some_engine(dim, cloud, engine)
    integer, intent(in) :: dim
    type(cloud_t), intent(out) :: cloud
    type(engine_t), intent(out) :: engine
    real(wp) :: high(3)
    integer :: cells(3)
    cells = merge(merge(150, merge(30, 12, dim == 2), dim == 1), 1, [1, 2, 3] <= dim)
    high = 0.0_wp
    high(:dim) = cells(:dim) - 2.0_wp
    call random_cloud(dim, 300, [0.0_wp, 0.0_wp, 0.0_wp], high, 0.1_wp, 0.5_wp, seed, cloud)
    cloud%material(::3) = 2
    call make_engine(dim, basis_cpgimp, cells, 0.25_wp, cloud, engine)
    engine%grid%lower(:dim) = [10.0_wp, -5.0_wp, 3.0_wp]
    engine%grid%lower(dim + 1:) = 0.0_wp
    call sort_particles(engine)
  end subroutine some_engine

  !> Mass, energy, momentum and angular momentum are those of the particles one by one: sums of 300 in another order
  subroutine test_totals(dim)
    integer, intent(in) :: dim
    type(engine_t) :: engine
    type(cloud_t) :: cloud
    type(totals_t) :: totals
    real(wp) :: x(3), momentum(3), angular(3), kinetic, stored, f(lanes, 9), state(lanes, 1), energy(lanes)
    integer :: i
    call some_engine(dim, cloud, engine)
    call measure_totals(engine, totals)
    momentum = 0.0_wp
    angular = 0.0_wp
    kinetic = 0.0_wp
    stored = 0.0_wp
    state = 0.0_wp
    do i = 1, cloud%n
      x = engine%grid%lower + 0.25_wp*cloud%x(:, i)
      if (dim < 3) x(dim + 1:) = 0.0_wp
      momentum = momentum + cloud%mass(i)*cloud%v(:, i)
      angular = angular + cloud%mass(i)*[x(2)*cloud%v(3, i) - x(3)*cloud%v(2, i), x(3)*cloud%v(1, i) - x(1)*cloud%v(3, i), &
                                         x(1)*cloud%v(2, i) - x(2)*cloud%v(1, i)]
      kinetic = kinetic + 0.5_wp*cloud%mass(i)*sum(cloud%v(:, i)**2)
      f = spread(cloud%f(:, i), 1, lanes)
      call engine%laws(cloud%material(i))%law%stored_energy(f, state, energy)
      stored = stored + cloud%volume(i)*energy(1)
    end do
    call check(totals%mass, sum(cloud%mass), 1.0e-13_wp*sum(cloud%mass), "mass, "//text_of(dim)//"D")
    call check(totals%kinetic, kinetic, 1.0e-13_wp*kinetic, "kinetic energy, "//text_of(dim)//"D")
    call check(totals%stored, stored, 1.0e-12_wp*stored, "stored energy of both materials, "//text_of(dim)//"D")
    call check(totals%momentum, momentum, 1.0e-13_wp*sum(cloud%mass), "momentum, "//text_of(dim)//"D")
    call check(totals%angular_momentum, angular, 1.0e-11_wp*sum(cloud%mass), "angular momentum, "//text_of(dim)//"D")
    call check(totals%speed, sqrt(maxval(sum(cloud%v**2, 1))), 1.0e-15_wp, "largest speed, "//text_of(dim)//"D")
  end subroutine test_totals

  !> Particles put where the manufactured solution has them have no error: round-off of positions and of moduli times strain.
  !> A known shift, slower velocities and another time show with their size.
  subroutine test_errors(dim)
    integer, intent(in) :: dim
    real(wp), parameter :: time = 0.013_wp, earlier = 0.011_wp
    type(engine_t) :: engine
    type(cloud_t) :: cloud
    type(verification_options_t) :: options
    type(verification_t) :: solution
    type(error_t), allocatable :: error
    type(errors_t) :: errors
    real(wp) :: reference(lanes, 3), u(lanes, 3), v(lanes, 3), f(lanes, 9), ignored(lanes, 3), f_ignored(lanes, 9), lambda, mu
    integer :: cells(3), i, k, q
    lambda = 600.0_wp
    mu = 400.0_wp
    options%solution = "axis_aligned"
    options%amplitude = 0.05_wp
    call make_verification(options, dim, "neo_hookean", 1000.0_wp, mu*(3*lambda + 2*mu)/(lambda + mu), &
                           0.5_wp*lambda/(lambda + mu), solution, error)
    call check_true(.not. allocated(error), "there is such a solution")
    call lattice_cloud(dim, [1, 1, 1], [8, 8, 8], merge(1, 2, dim == 3), 0.1_wp, 1000.0_wp, cloud)
    do i = 1, cloud%n
      reference = spread(0.1_wp*cloud%x(:, i), 1, lanes)
      call exact_motion(solution, earlier, reference, ignored, v, f_ignored)
      call exact_motion(solution, time, reference, u, ignored, f)
      cloud%v(:, i) = v(1, :)
      cloud%f(:, i) = f(1, :)
      cloud%half(:, i) = u(1, :) ! carried along: the place is set after the sort
    end do
    cells = merge(10, 1, [1, 2, 3] <= dim)
    call make_engine(dim, basis_ugimp, cells, 0.1_wp, cloud, engine)
    call sort_particles(engine)
    q = engine%particles%position%first
    do k = 1, engine%particles%chunks
      do i = 1, lanes
        if (engine%particles%id(i, k) == 0) cycle
        engine%particles%p(i, q:q + dim - 1, k) = engine%particles%p(i, q:q + dim - 1, k) &
                                                  + cloud%half(:dim, int(engine%particles%id(i, k)))/0.1_wp
      end do
    end do
    call measure_errors(engine, solution, time, earlier, errors)
    call check(real(max(errors%rms, errors%max), wp), 0.0_wp, 1.0e-14_wp, "no error of positions, "//text_of(dim)//"D")
    call check(real(max(errors%rms_velocity, errors%max_velocity), wp), 0.0_wp, 1.0e-14_wp, &
               "nor of velocities, "//text_of(dim)//"D")
    call check(real(max(errors%rms_stress, errors%max_stress), wp), 0.0_wp, 1.0e-11_wp, "nor of stress, "//text_of(dim)//"D")
    engine%particles%p(:, q, :) = engine%particles%p(:, q, :) + 0.02_wp
    call measure_errors(engine, solution, time, time, errors)
    call check(real(errors%rms, wp), 0.002_wp, 1.0e-14_wp, "a shift of 0.02 cells is 0.002 m of error, "//text_of(dim)//"D")
    call check(real(errors%max, wp), 0.002_wp, 1.0e-14_wp, "for each particle, "//text_of(dim)//"D")
    call check_true(errors%rms_velocity > 1.0e-6_dp .and. errors%max_velocity >= errors%rms_velocity, &
                    "velocities of another time do differ, "//text_of(dim)//"D")
  end subroutine test_errors

  !> The order of groups, chunks and lanes does not matter; every bit of every field, the number, the step and the time do
  subroutine test_hash()
    type(engine_t) :: engine
    type(cloud_t) :: cloud
    integer(i8) :: hash, kept
    real(wp) :: lane(64), column(lanes)
    integer :: f, n, c, missed
    call some_engine(2, cloud, engine)
    hash = state_hash(engine, 7_i8, 0.5_wp)
    call check_true(state_hash(engine, 7_i8, 0.5_wp) == hash, "the same state has the same hash")
    n = size(engine%particles%groups)
    engine%particles%groups = engine%particles%groups(n:1:-1)
    call check_true(state_hash(engine, 7_i8, 0.5_wp) == hash, "groups in another order")
    c = findloc(engine%particles%id(2, :) > 0, .true., dim=1)
    call check_true(c > 0, "two lanes to swap")
    n = engine%particles%components
    lane(:n) = engine%particles%p(1, :, c)
    kept = engine%particles%id(1, c)
    engine%particles%p(1, :, c) = engine%particles%p(2, :, c)
    engine%particles%id(1, c) = engine%particles%id(2, c)
    engine%particles%p(2, :, c) = lane(:n)
    engine%particles%id(2, c) = kept
    call check_true(state_hash(engine, 7_i8, 0.5_wp) == hash, "lanes in another order")
    missed = 0
    do f = 1, engine%particles%components
      column = engine%particles%p(:, f, c)
      engine%particles%p(1, f, c) = nearest(engine%particles%p(1, f, c), 1.0_wp)
      if (state_hash(engine, 7_i8, 0.5_wp) == hash) missed = missed + 1
      engine%particles%p(:, f, c) = column
    end do
    call check(missed, 0, "the last bit of every field counts")
    call check_true(state_hash(engine, 8_i8, 0.5_wp) /= hash, "the step counts")
    call check_true(state_hash(engine, 7_i8, nearest(0.5_wp, 1.0_wp)) /= hash, "the time counts")
    engine%particles%id(1:2, c) = engine%particles%id(2:1:-1, c)
    call check_true(state_hash(engine, 7_i8, 0.5_wp) /= hash, "who is who counts")
    engine%particles%id(1:2, c) = engine%particles%id(2:1:-1, c)
    call check_true(state_hash(engine, 7_i8, 0.5_wp) == hash, "all is as it was")
    do c = 1, engine%particles%chunks
      where (engine%particles%id(:, c) == 0) engine%particles%p(:, 2, c) = 17.0_wp
    end do
    call check_true(state_hash(engine, 7_i8, 0.5_wp) == hash, "spare lanes do not count")
  end subroutine test_hash

  !> By number and by place, absolute in metres
  subroutine test_find()
    type(engine_t) :: engine
    type(cloud_t) :: cloud
    real(wp) :: x(lanes, 3), j(lanes), sigma(lanes, 6), point(2)
    integer :: i, g, c, l, wrong, best
    integer(i8) :: id
    call some_engine(2, cloud, engine)
    wrong = 0
    do i = 1, cloud%n, 17
      call find_particle(engine%particles, int(i, i8), g, c, l)
      if (c == 0) then
        wrong = wrong + 1
        cycle
      end if
      call chunk_position(engine, engine%particles%groups(g), c, x)
      if (maxval(abs(x(l, :2) - engine%grid%lower(:2) - 0.25_wp*cloud%x(:2, i))) > 1.0e-13_wp) wrong = wrong + 1
      call chunk_stress(engine, engine%particles%groups(g), c, sigma, j)
      if (abs(j(l) - (cloud%f(1, i)*cloud%f(5, i) - cloud%f(2, i)*cloud%f(4, i))) > 1.0e-15_wp) wrong = wrong + 1
      point = x(l, :2) + 1.0e-6_wp
      best = minloc((cloud%x(1, :)*0.25_wp + engine%grid%lower(1) - point(1))**2 &
                    + (cloud%x(2, :)*0.25_wp + engine%grid%lower(2) - point(2))**2, dim=1)
      if (nearest_particle(engine, point, 1_i8, int(cloud%n, i8)) /= best) wrong = wrong + 1
    end do
    call check(wrong, 0, "every particle is found by number, where it is, and by place")
    call find_particle(engine%particles, 100000_i8, g, c, l)
    call check(c, 0, "a particle that is gone is not found")
    id = nearest_particle(engine, [11.0_wp, -4.0_wp], 20_i8, 25_i8)
    call check_true(id >= 20 .and. id <= 25, "numbers can be limited")
  end subroutine test_find

end program test_measures
