!> Affine transfers (APIC, TPIC): affine velocity fields pass the grid unchanged, momentum and angular momentum are kept
program test_affine
  use gimp_kinds, only: wp, lanes
  use gimp_grid, only: nodes_per_block
  use gimp_splines, only: spline_t, make_spline, node_place
  use gimp_basis, only: basis_cpgimp, basis_bspline2, basis_bspline3, basis_cpdi, basis_gauss, spline_degree, list_inertia, make_weight_list, take_moments, &
    inertia_of_list, weight_list_t
  use gimp_point_domains, only: point_rule_t, corner_rule, simpson_rule, volume_rule
  use gimp_particle_list, only: particle_list
  use gimp_engine, only: engine_t, pass_t, fate_fine, affine_apic, affine_tpic, sum_affine
  use gimp_particle_pass, only: particle_pass
  use gimp_resort, only: sort_particles
  use gimp_engine_fixture, only: cloud_t, random_cloud, make_engine, node_sums, random_reals
  use gimp_check, only: begin_suite, end_suite, check, check_true
  implicit none(type, external)

  integer :: seed = 11, dim, kind, basis

  call begin_suite("affine")
  call test_moments()
  do dim = 1, 3
    do kind = affine_apic, affine_tpic
      call test_affine_field(dim, kind, basis_cpgimp, .false., 0.5_wp, .false.)
      call test_affine_field(dim, kind, basis_cpgimp, .false., 1.9_wp, .false.) ! wide supports walk their lists
      call test_affine_field(dim, kind, basis_cpgimp, .false., 0.5_wp, .true.)
      call test_affine_field(dim, kind, basis_cpdi, .false., 0.5_wp, .false., corner_rule(dim))
      call test_affine_field(dim, kind, basis_cpdi, .false., 1.5_wp, .false., corner_rule(dim))
      call test_affine_field(dim, kind, basis_cpdi, .false., 0.5_wp, .true., corner_rule(dim))
      call test_affine_field(dim, kind, basis_gauss, .false., 0.5_wp, .false., simpson_rule(dim))
      call test_affine_field(dim, kind, basis_gauss, .false., 0.5_wp, .false., volume_rule(dim, 2))
      do basis = basis_bspline2, basis_bspline3
        call test_affine_field(dim, kind, basis, .false., 0.5_wp, .false.)
        call test_affine_field(dim, kind, basis, .true., 0.5_wp, .false.)
        call test_affine_field(dim, kind, basis, .true., 0.5_wp, .true.)
      end do
    end do
    call test_momentum(dim, basis_cpgimp, .false.)
    call test_momentum(dim, basis_cpdi, .false., corner_rule(dim))
    call test_momentum(dim, basis_gauss, .false., simpson_rule(dim))
    call test_momentum(dim, basis_gauss, .false., volume_rule(dim, 2))
    do basis = basis_bspline2, basis_bspline3
      call test_momentum(dim, basis, .false.)
      call test_momentum(dim, basis, .true.)
    end do
  end do
  call end_suite()

contains

  !> Moments of a particle sum to zero, and against the distances they give the inertia
  subroutine test_moments()
    type(weight_list_t) :: list
    real(wp) :: numbers(6), x(3), half(3), inertia(3), sums(3), squares(3)
    integer :: n, i
    do n = 1, 50
      call random_reals(seed, numbers)
      x = 5.0_wp + numbers(1:3)
      half = 0.01_wp + 0.6_wp*abs(numbers(4:6))
      call make_weight_list(3, x, half, spline_t(), list)
      call take_moments(3, x, spline_t(), list)
      inertia = list_inertia(3, x, half, spline_t())
      sums = 0.0_wp
      squares = 0.0_wp
      do i = 1, list%n
        sums = sums + list%g(:, i)
        squares = squares + list%g(:, i)*(list%node(:, i) - x)
      end do
      call check(sums, [0.0_wp, 0.0_wp, 0.0_wp], 1.0e-13_wp, "moments sum to zero") ! weights of order 1, 1/half <= 100
      call check(squares, inertia, 1.0e-12_wp, "moments times distances are the inertia")
      call check_true(all(inertia >= half**2/3.0_wp - 1.0e-12_wp), "inertia is at least half^2/3")
    end do
  end subroutine test_moments

  !> Nodal velocities of an affine field: particles take its value and its gradient, and give the field back to the nodes
  subroutine test_affine_field(dim, kind, basis, open, long, list_kernel, rule)
    integer, intent(in) :: dim, kind, basis
    real(wp), intent(in) :: long !! largest half length
    logical, intent(in) :: open, list_kernel !! open knots; the list kernel everywhere
    type(point_rule_t), intent(in), optional :: rule !! of a basis that samples its domains
    type(engine_t) :: engine
    type(cloud_t) :: cloud
    real(wp), allocatable :: raw(:, :, :)
    real(wp) :: low(3), high(3), gradient(3, 3), v0(3), numbers(12), worst, worst_gradient, given(3)
    integer :: cells(3), c, l, g, k, s, place, q
    cells = 1
    cells(:dim) = merge(150, merge(20, 12, dim == 2), dim == 1)
    low = 0.0_wp
    low(:dim) = merge(0.0_wp, 3.0_wp, open)
    high = cells - low
    call random_cloud(dim, 200, low, high, 0.05_wp, long, seed, cloud)
    call make_engine(dim, basis, cells, 0.25_wp, cloud, engine, affine=kind, rule=rule)
    if (open) engine%grid%open_degree = spline_degree(basis)
    engine%list_kernel = list_kernel
    call sort_particles(engine)
    call random_reals(seed, numbers)
    gradient = reshape(numbers(:9), [3, 3])
    v0 = numbers(10:12)
    do s = 1, engine%table%slots
      do place = 1, nodes_per_block
        engine%g(:, place, s) = 0.0_wp
        engine%g(1:dim, place, s) = field(gradient, v0, place_of(engine, s, place), dim)
      end do
    end do
    call particle_pass(engine, pass_t(velocity=.true., flip=0.0_wp, momentum=.true., old_weights=.true.))
    call check_true(all(engine%fate(1, :) == fate_fine), "no particle is lost")
    worst = 0.0_wp
    worst_gradient = 0.0_wp
    associate (p => engine%particles)
      do g = 1, size(p%groups)
        do c = p%groups(g)%first, p%groups(g)%last
          do l = 1, lanes
            if (p%id(l, c) == 0) cycle
            worst = max(worst, maxval(abs(p%p(l, p%velocity%first:p%velocity%first + dim - 1, c) - &
              field(gradient, v0, 0.25_wp*(p%p(l, 1:dim, c) + p%groups(g)%at(:dim)*engine%grid%edge(:dim)), dim))))
            do k = 1, dim
              q = p%affine%first + dim*(k - 1)
              worst_gradient = max(worst_gradient, maxval(abs(p%p(l, q:q + dim - 1, c) - gradient(k, :dim))))
            end do
          end do
        end do
      end do
    end associate
    ! coordinates up to 40 m, gradients of order 1: 1e-14 of 40; the inertia may be as small as 0.05^2/3, hence 1e-10 for C
    call check(worst, 0.0_wp, 1.0e-12_wp, "particles take the value of an affine field")
    call check(worst_gradient, 0.0_wp, 1.0e-10_wp, "and its gradient")
    call node_sums(engine, raw)
    worst = 0.0_wp
    do s = 1, engine%table%slots
      do place = 1, nodes_per_block
        if (raw(4, place, s) < 1.0e-3_wp*maxval(cloud%mass)) cycle ! round-off of light nodes is divided by their mass
        given = 0.0_wp
        given(:dim) = field(gradient, v0, place_of(engine, s, place), dim)
        worst = max(worst, maxval(abs(raw(1:dim, place, s)/raw(4, place, s) - given(:dim))))
      end do
    end do
    call check(worst, 0.0_wp, 1.0e-9_wp, "nodes get the affine field back")
  end subroutine test_affine_field

  !> Random particle velocities and gradients: the grid has the momentum of the particles and, with the affine part, their
  !> angular momentum (2D, 3D); the energy of the affine part is positive
  subroutine test_momentum(dim, basis, open, rule)
    integer, intent(in) :: dim, basis
    logical, intent(in) :: open
    type(point_rule_t), intent(in), optional :: rule !! of a basis that samples its domains
    type(weight_list_t) :: list
    type(engine_t) :: engine
    type(cloud_t) :: cloud
    real(wp), allocatable :: raw(:, :, :), numbers(:)
    real(wp) :: low(3), high(3), on_nodes(3), of_particles(3), spin_nodes(3), spin_particles(3), x(3), mv(3), b(3, 3), inertia(3, 3), scale
    integer :: cells(3), c, l, g, s, place, q, k
    cells = 1
    cells(:dim) = merge(150, merge(20, 12, dim == 2), dim == 1)
    low = 0.0_wp
    low(:dim) = merge(0.0_wp, 3.0_wp, open)
    high = cells - low
    call random_cloud(dim, 200, low, high, 0.05_wp, 0.5_wp, seed, cloud)
    call make_engine(dim, basis, cells, 0.25_wp, cloud, engine, affine=affine_apic, rule=rule)
    if (open) engine%grid%open_degree = spline_degree(basis)
    call sort_particles(engine)
    allocate (numbers(dim*dim))
    on_nodes = 0.0_wp
    of_particles = 0.0_wp
    spin_nodes = 0.0_wp
    spin_particles = 0.0_wp
    scale = 0.0_wp
    associate (p => engine%particles)
      do g = 1, size(p%groups)
        do c = p%groups(g)%first, p%groups(g)%last
          do l = 1, lanes
            if (p%id(l, c) == 0) cycle
            call random_reals(seed, numbers)
            q = p%affine%first
            p%p(l, q:q + dim*dim - 1, c) = numbers
            x = 0.0_wp
            x(:dim) = 0.25_wp*(p%p(l, 1:dim, c) + p%groups(g)%at(:dim)*engine%grid%edge(:dim))
            mv = 0.0_wp
            mv(:dim) = p%p(l, p%mass%first, c)*p%p(l, p%velocity%first:p%velocity%first + dim - 1, c)
            call particle_list(engine, p%groups(g)%at, c, l, list)
            inertia = inertia_of_list(dim, p%p(l, 1:dim, c), make_spline(spline_degree(basis), engine%grid, p%groups(g)%at), list)
            b = 0.0_wp
            do k = 1, dim
              b(k, :dim) = p%p(l, p%mass%first, c)*0.25_wp**2*matmul(numbers(dim*(k - 1) + 1:dim*k), inertia(:dim, :dim))
            end do
            of_particles = of_particles + mv
            spin_particles = spin_particles + cross(x, mv) + [b(3, 2) - b(2, 3), b(1, 3) - b(3, 1), b(2, 1) - b(1, 2)]
            scale = scale + sum(abs(mv))
          end do
        end do
      end do
    end associate
    call particle_pass(engine, pass_t(momentum=.true.))
    call node_sums(engine, raw)
    do s = 1, engine%table%slots
      do place = 1, nodes_per_block
        on_nodes = on_nodes + raw(1:3, place, s)
        spin_nodes = spin_nodes + cross(place_of(engine, s, place), raw(1:3, place, s))
      end do
    end do
    call check(on_nodes, of_particles, 1.0e-13_wp*scale, "momentum on the grid is that of the particles")
    call check(spin_nodes, spin_particles, 1.0e-11_wp*scale, "and so is the angular momentum, affine part included") ! arms of 40 m
    call check_true(sum(engine%sums(sum_affine, :)) > 0.0_wp, "the affine part has kinetic energy")
  end subroutine test_momentum

  pure function field(gradient, v0, x, dim) result(v)
    integer, intent(in) :: dim
    real(wp), intent(in) :: gradient(3, 3), v0(3), x(:)
    real(wp) :: v(dim)
    v = v0(:dim) + matmul(gradient(:dim, :dim), x(:dim))
  end function field

  !> Where a node stands [m]: with open knots at its Greville abscissa
  pure function place_of(engine, s, place) result(x)
    type(engine_t), intent(in) :: engine
    integer, intent(in) :: s, place
    real(wp) :: x(3)
    integer :: node(3), k
    associate (edge => engine%grid%edge)
      node = [modulo(place - 1, edge(1)), modulo((place - 1)/edge(1), edge(2)), (place - 1)/(edge(1)*edge(2))] &
             + engine%table%slot_at(:, s)*edge
    end associate
    do k = 1, 3
      x(k) = 0.25_wp*node(k)
      if (k <= engine%grid%dim) &
        x(k) = 0.25_wp*node_place(make_spline(spline_degree(engine%basis), engine%grid, [0, 0, 0]), k, node(k))
    end do
  end function place_of

  pure function cross(u, w) result(c)
    real(wp), intent(in) :: u(3), w(3)
    real(wp) :: c(3)
    c = [u(2)*w(3) - u(3)*w(2), u(3)*w(1) - u(1)*w(3), u(1)*w(2) - u(2)*w(1)]
  end function cross

end program test_affine
