!> The critical step equals the one of a dense matrix, the closed form of one particle, and the step at which runs start to grow
program test_stability
  use gimp_kinds, only: wp
  use gimp_splines, only: spline_t
  use gimp_basis, only: basis_linear, basis_ugimp, basis_cpgimp, weight_list_t, make_weight_list
  use gimp_domains, only: domain_stretch
  use gimp_engine, only: engine_t, affine_none, affine_apic
  use gimp_error, only: error_t
  use gimp_resort, only: sort_particles
  use gimp_stability, only: critical_step, check_of_word, check_word, check_none, check_gershgorin, check_lanczos, strains_plain, &
    strains_after_kick, strains_smoothed
  use gimp_step_size, only: rule_fixed
  use gimp_run_state, only: stepper_t, usf, usl, musl, usavg
  use gimp_stepper, only: start_run, plan_step, take_step
  use gimp_walls, only: walls_t, side_stick, side_periodic, side_symmetry, set_walls
  use gimp_engine_fixture, only: cloud_t, make_cloud, random_cloud, lattice_cloud, make_engine
  use gimp_text, only: text_of
  use gimp_check, only: begin_suite, end_suite, check, check_true
  use omp_lib, only: omp_set_num_threads
  implicit none(type, external)

  real(wp), parameter :: spacing = 0.1_wp, speed = sqrt(1.4_wp) !! of the unstressed material of the fixture [m/s]
  integer :: scheme

  call omp_set_num_threads(1)
  call begin_suite("stability")
  call test_words()
  call test_one_particle()
  call test_bar()
  call test_dense(1, basis_linear)
  call test_dense(2, basis_linear)
  call test_dense(2, basis_cpgimp)
  call test_dense(3, basis_ugimp)
  do scheme = usf, usavg
    call test_growth(1, basis_linear, scheme, affine_none, 1.0_wp, .true.)
    call test_growth(2, basis_cpgimp, scheme, affine_none, 1.0_wp, .true.)
  end do
  call test_growth(2, basis_linear, usl, affine_none, 1.0_wp, .true.)
  call test_growth(2, basis_cpgimp, musl, affine_none, 0.0_wp, .false.)
  call test_growth(2, basis_cpgimp, musl, affine_apic, 0.95_wp, .false.)
  call test_growth(2, basis_cpgimp, usl, affine_apic, 0.95_wp, .false.)
  call test_sides()
  call test_threads()
  call end_suite()

contains

  subroutine test_words()
    integer :: k
    do k = check_none, check_lanczos
      call check(check_of_word(check_word(k)), k, "words of the checks go both ways")
    end do
    call check(check_of_word("guess"), -1, "an unknown word")
  end subroutine test_words

  !> critical_step of a sorted engine without sides
  real(wp) function found(engine, which, strains)
    type(engine_t), intent(inout) :: engine
    integer, intent(in) :: which, strains
    type(walls_t) :: free
    logical :: held(engine%table%slots)
    held = .false.
    call critical_step(engine, free, held, 0.0_wp, which, strains, 1.0_wp, found)
  end function found

  !> One particle at the share xi of a cell: 2 (h/c) sqrt(xi (1 - xi)) of M^-1 K, (h/c) sqrt(2 xi (1 - xi)) with usl, nothing
  !> when the velocity went through the particle. Two vectors span the space: the iteration is exact to round-off.
  subroutine test_one_particle()
    real(wp), parameter :: shares(4) = [0.5_wp, 0.2_wp, 0.1_wp, 0.01_wp]
    type(cloud_t) :: cloud
    type(engine_t) :: engine
    real(wp) :: exact
    integer :: k
    do k = 1, size(shares)
      if (allocated(cloud%x)) deallocate (cloud%x)
      call make_cloud(1, cloud)
      cloud%x(1, 1) = 5 + shares(k)
      cloud%volume = spacing/2
      cloud%mass = 1000*cloud%volume
      call make_engine(1, basis_linear, [12, 1, 1], spacing, cloud, engine)
      call sort_particles(engine)
      exact = 2*spacing/speed*sqrt(shares(k)*(1 - shares(k)))
      call check(found(engine, check_lanczos, strains_plain)/exact, 1.0_wp, 1.0e-9_wp, "one particle at "//text_of(shares(k)))
      call check(found(engine, check_lanczos, strains_after_kick)/exact, sqrt(0.5_wp), 1.0e-9_wp, "one particle with usl")
      ! round-off of the smoothing: P a is some 1e-16 of a
      call check_true(found(engine, check_lanczos, strains_smoothed) > 1.0e5_wp*exact, "one particle with musl is stable")
      call check_true(found(engine, check_gershgorin, strains_plain) <= exact*(1 + 1.0e-12_wp), "Gershgorin is below")
      call check_true(found(engine, check_gershgorin, strains_plain) >= 0.7_wp*exact, "but not by much") ! at most a factor sqrt(2)
    end do
  end subroutine test_one_particle

  !> A bar with two particles a cell, the last of them a little beyond a node: 0.61, 0.20, 0.063, 0.002 h/c with tents (figures
  !> of an independent calculation, with two digits). With GIMP weights no place of the bar is worse than 0.82.
  subroutine test_bar()
    real(wp), parameter :: beyond(4) = [0.1_wp, 0.01_wp, 1.0e-3_wp, 1.0e-6_wp], expected(4) = [0.61_wp, 0.20_wp, 0.063_wp, 0.002_wp]
    integer :: k
    do k = 1, size(beyond)
      call check(bar(basis_linear, 0.25_wp + beyond(k))/expected(k), 1.0_wp, 0.02_wp, "bar with tents, beyond by "//text_of(beyond(k)))
    end do
    do k = 0, 20
      call check_true(bar(basis_ugimp, k/40.0_wp) > 0.82_wp, "bar with GIMP")
      call check_true(bar(basis_ugimp, k/40.0_wp) < 1.01_wp, "bar with GIMP: h/c at most")
    end do
  end subroutine test_bar

  !> Critical step of M^-1 K in h/c of a bar of 10 cells
  real(wp) function bar(basis, shift)
    integer, intent(in) :: basis
    real(wp), intent(in) :: shift !! of the bar against the grid [cells]
    type(cloud_t) :: cloud
    type(engine_t) :: engine
    call lattice_cloud(1, [4, 0, 0], [10, 1, 1], 2, spacing, 1000.0_wp, cloud)
    cloud%x(1, :) = cloud%x(1, :) + shift
    call make_engine(1, basis, [20, 1, 1], spacing, cloud, engine)
    call sort_particles(engine)
    bar = found(engine, check_lanczos, strains_plain)*speed/spacing
  end function bar

  !> Against the largest eigenvalue of the assembled matrices, found by many power iterations. Random particles leave some nodes
  !> with little mass, which separates the largest eigenvalue: 1 % holds for the square root
  subroutine test_dense(dim, basis)
    integer, intent(in) :: dim, basis
    type(cloud_t) :: cloud
    type(engine_t) :: engine
    real(wp), allocatable :: k(:, :), mass(:), consistent(:, :)
    real(wp) :: exact(3), dt, bound
    integer :: seed, s
    character(len=:), allocatable :: which
    which = ", "//text_of(dim)//"D, basis "//text_of(basis)
    seed = 7*dim + basis
    call random_cloud(dim, merge(24, 12*dim, dim == 1), merge([3.1_wp, 3.1_wp, 3.1_wp], 0.0_wp, [1, 2, 3] <= dim), &
                      merge([6.3_wp, 5.4_wp, 4.7_wp], 0.0_wp, [1, 2, 3] <= dim), 0.15_wp, 0.45_wp, seed, cloud)
    cloud%f = spread([1.0_wp, 0.0_wp, 0.0_wp, 0.0_wp, 1.0_wp, 0.0_wp, 0.0_wp, 0.0_wp, 1.0_wp], 2, cloud%n) ! c is known then
    call make_engine(dim, basis, merge([12, 12, 12], 1, [1, 2, 3] <= dim), spacing, cloud, engine)
    call sort_particles(engine)
    call assemble(dim, basis, cloud, k, mass, consistent)
    call dense_eigenvalues(k, mass, consistent, exact)
    do s = strains_plain, strains_smoothed
      dt = found(engine, check_lanczos, s)*speed/spacing
      call check(dt*sqrt(exact(s))/2, 1.0_wp, 0.01_wp, "dense matrix, strains "//text_of(s)//which)
      call check_true(dt*sqrt(exact(s))/2 > 1 - 1.0e-6_wp, "the iteration comes from below"//which)
    end do
    bound = found(engine, check_gershgorin, strains_plain)*speed/spacing
    call check_true(bound*sqrt(exact(1))/2 <= 1 + 1.0e-12_wp, "Gershgorin is a bound"//which)
    call check_true(bound*sqrt(exact(1))/2 > 0.3_wp, "within a factor of three"//which)
    bound = found(engine, check_gershgorin, strains_after_kick)*speed/spacing
    call check_true(bound*sqrt(exact(2))/2 <= 1 + 1.0e-12_wp, "Gershgorin is a bound with usl"//which)
  end subroutine test_dense

  !> Stiffness, lumped and consistent mass of a cloud on 13 nodes an axis, in units of c and the spacing
  subroutine assemble(dim, basis, cloud, k, mass, consistent)
    integer, intent(in) :: dim, basis
    type(cloud_t), intent(in) :: cloud
    real(wp), allocatable, intent(out) :: k(:, :), mass(:), consistent(:, :)
    real(wp), allocatable :: full(:, :), lumped(:), smooth(:, :)
    real(wp), parameter :: lambda = 600.0_wp/1400.0_wp, mu = 400.0_wp/1400.0_wp
    type(weight_list_t) :: list
    real(wp) :: half(3)
    integer, allocatable :: number(:), at(:), row(:)
    integer :: i, j, p, a, b, n, rows
    n = 13**dim
    allocate (number(n), source=0)
    rows = 0
    do p = 1, 2*cloud%n ! number the nodes, then add
      half = cloud%half(:, modulo(p - 1, cloud%n) + 1)
      if (basis == basis_linear) half = 0
      call make_weight_list(dim, cloud%x(:dim, modulo(p - 1, cloud%n) + 1), half, spline_t(), list)
      at = [(1 + list%node(1, i) + 13*(list%node(2, i) + 13*list%node(3, i)), i=1, list%n)]
      if (p <= cloud%n) then
        do i = 1, list%n
          if (number(at(i)) > 0) cycle
          rows = rows + 1
          number(at(i)) = rows
        end do
        cycle
      end if
      row = dim*(number(at) - 1)
      if (.not. allocated(full)) then
        allocate (full(dim*rows, dim*rows), lumped(dim*rows), smooth(dim*rows, dim*rows))
        full = 0
        lumped = 0
        smooth = 0
      end if
      associate (m => cloud%mass(p - cloud%n))
        do i = 1, list%n
          do a = 1, dim
            lumped(row(i) + a) = lumped(row(i) + a) + m*list%s(i)
            do j = 1, list%n
              smooth(row(i) + a, row(j) + a) = smooth(row(i) + a, row(j) + a) + m*list%s(i)*list%s(j)
              do b = 1, dim
                full(row(i) + a, row(j) + b) = full(row(i) + a, row(j) + b) &
                  + m*(lambda*list%g(a, i)*list%g(b, j) + mu*list%g(b, i)*list%g(a, j))
                if (a == b) full(row(i) + a, row(j) + b) = full(row(i) + a, row(j) + b) + m*mu*sum(list%g(:, i)*list%g(:, j))
              end do
            end do
          end do
        end do
      end associate
    end do
    call move_alloc(full, k)
    call move_alloc(lumped, mass)
    call move_alloc(smooth, consistent)
  end subroutine assemble

  !> Largest eigenvalues of W M^-1 K for W = 1, 2 - P, P by power iterations with Rayleigh quotients in the product x.K y
  subroutine dense_eigenvalues(k, mass, consistent, values)
    real(wp), intent(in) :: k(:, :), mass(:), consistent(:, :)
    real(wp), intent(out) :: values(3)
    real(wp) :: x(size(mass)), y(size(mass)), kx(size(mass))
    integer :: w, i, step
    do w = 1, 3
      x = [(sin(1.7_wp*i*i), i=1, size(x))]
      do step = 1, 3000
        kx = matmul(k, x)
        y = kx/max(mass, tiny(1.0_wp))
        where (mass <= 0) y = 0
        if (w == strains_after_kick) y = 2*y - smoothed(mass, consistent, y)
        if (w == strains_smoothed) y = smoothed(mass, consistent, y)
        values(w) = sum(kx*y)/sum(kx*x)
        x = y/sqrt(sum(y*y))
      end do
    end do
  end subroutine dense_eigenvalues

  !> Grid to particles and back
  pure function smoothed(mass, consistent, a)
    real(wp), intent(in) :: mass(:), consistent(:, :), a(:)
    real(wp) :: smoothed(size(a))
    smoothed = matmul(consistent, a)/max(mass, tiny(1.0_wp))
    where (mass <= 0) smoothed = 0
  end function smoothed

  !> Noise of 1e-9 of a wave in a body that does not fit the grid: 3 % below the critical step it stays small, 3 % above it is
  !> a thousand times larger after 400 steps (each multiplies it by 1.2 and more), or has inverted a particle
  subroutine test_growth(dim, basis, scheme, affine, flip, sharp)
    integer, intent(in) :: dim, basis, scheme, affine
    real(wp), intent(in) :: flip
    logical, intent(in) :: sharp !! the limit is exact, not only a bound
    type(stepper_t) :: s
    type(cloud_t) :: cloud
    type(error_t), allocatable :: error
    real(wp) :: critical, start
    integer :: trial, k, d
    character(len=:), allocatable :: which
    which = ", "//text_of(dim)//"D, basis "//text_of(basis)//", scheme "//text_of(scheme)//", affine "//text_of(affine)
    critical = 0
    do trial = 0, merge(2, 1, sharp)
      call lattice_cloud(dim, [3, 3, 0], [4, 3, 1], 2, spacing, 1000.0_wp, cloud)
      do d = 1, dim
        cloud%x(d, :) = cloud%x(d, :) + 0.117_wp*d
        cloud%v(d, :) = [(1.0e-9_wp*sin(9.1_wp*k*k + d), k=1, cloud%n)]
      end do
      s = stepper_t()
      if (affine == affine_none) then
        call make_engine(dim, basis, merge([12, 12, 12], 1, [1, 2, 3] <= dim), spacing, cloud, s%engine)
      else
        call make_engine(dim, basis, merge([12, 12, 12], 1, [1, 2, 3] <= dim), spacing, cloud, s%engine, affine=affine)
      end if
      if (basis == basis_cpgimp) s%engine%domain_rule = domain_stretch
      s%method%scheme = scheme
      s%method%flip = flip
      s%time_options%check = check_lanczos
      s%time_options%check_every = huge(1)
      s%time_options%rule = rule_fixed
      s%time_options%step = merge(1.03_wp, 0.97_wp, trial == 2)*critical
      call start_run(s, error)
      start = real(s%books%kinetic, wp)
      do k = 1, 400
        if (.not. allocated(error)) call plan_step(s, 1.0e9_wp, error)
        if (trial == 0) exit
        if (.not. allocated(error)) call take_step(s, error)
      end do
      critical = s%critical
      if (trial == 1) call check_true(.not. allocated(error) .and. s%books%kinetic < 100*start, "noise stays small below the limit"//which)
      if (trial == 2) call check_true(allocated(error) .or. s%books%kinetic > 1.0e6_wp*start, "noise grows above the limit"//which)
      if (allocated(error)) deallocate (error)
    end do
  end subroutine test_growth

  !> A body over the seam of a periodic box has the step of one inside, one at a plane of symmetry that of the whole body or
  !> more, and sides that hold nodes do not shorten the step
  subroutine test_sides()
    type(stepper_t) :: s
    type(cloud_t) :: cloud
    real(wp) :: inside, seam
    integer :: k
    do k = 1, 4
      call lattice_cloud(2, [4, 4, 0], [4, 3, 1], 2, spacing, 1000.0_wp, cloud)
      cloud%x(1, :) = cloud%x(1, :) + 0.117_wp
      if (k == 2) cloud%x(1, :) = modulo(cloud%x(1, :) + 6, 12.0_wp)
      if (k > 2) cloud%x(1, :) = cloud%x(1, :) - 4.117_wp
      s = stepper_t()
      call make_engine(2, basis_ugimp, [12, 12, 1], spacing, cloud, s%engine, uniform=.true.)
      if (k == 2) s%walls%side(:, 1)%condition = side_periodic
      if (k == 3) s%walls%side(1, 1)%condition = side_stick
      if (k == 4) s%walls%side(1, 1)%condition = side_symmetry
      call set_walls(s%walls, s%engine%grid)
      s%method%scheme = usl
      s%time_options%check = check_lanczos
      s%time_options%step = 1.0e-3_wp
      s%time_options%rule = rule_fixed
      call plan(s)
      if (k == 1) inside = s%critical
      if (k == 2) seam = s%critical
      if (k > 2) call check_true(s%critical > 0.98_wp*inside, "a side does not shorten the critical step, case "//text_of(k))
    end do
    call check(seam/inside, 1.0_wp, 5.0e-3_wp, "the seam of a periodic box is no surface") ! another start vector
  end subroutine test_sides

  subroutine plan(s)
    type(stepper_t), intent(inout) :: s
    type(error_t), allocatable :: error
    call start_run(s, error)
    call plan_step(s, 1.0e9_wp, error)
    call check_true(.not. allocated(error), "the run starts")
  end subroutine plan

  !> The same bits on any number of threads
  subroutine test_threads()
    type(stepper_t) :: s
    type(cloud_t) :: cloud
    real(wp) :: steps(3, check_gershgorin:check_lanczos)
    integer :: threads, which, seed
    do threads = 1, 3
      call omp_set_num_threads(threads)
      do which = check_gershgorin, check_lanczos
        seed = 5
        call random_cloud(2, 400, [2.1_wp, 2.1_wp, 0.0_wp], [28.0_wp, 28.0_wp, 0.0_wp], 0.1_wp, 0.6_wp, seed, cloud)
        s = stepper_t()
        call make_engine(2, basis_ugimp, [32, 32, 1], spacing, cloud, s%engine, uniform=.true.)
        s%time_options%check = which
        s%time_options%step = 1.0e-3_wp
        s%time_options%rule = rule_fixed
        call plan(s)
        steps(threads, which) = s%critical
      end do
    end do
    call check_true(all(steps(1, :) == steps(2, :)) .and. all(steps(1, :) == steps(3, :)), "same bits on 1, 2 and 3 threads")
    call omp_set_num_threads(1)
  end subroutine test_threads

end program test_stability
