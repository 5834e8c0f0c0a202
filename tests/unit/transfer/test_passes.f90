!> Whole passes over blocks: fast and list kernel agree, nothing is lost on the way to the grid, wherever particles strayed
program test_passes
  use gimp_kinds, only: wp, dp, lanes
  use gimp_grid, only: nf => fields_per_node
  use gimp_basis, only: basis_linear, basis_ugimp, basis_cpgimp, basis_bspline2, basis_bspline3, basis_ddmp, spline_degree
  use gimp_domains, only: domain_stretch
  use gimp_engine, only: engine_t, pass_t, sum_external, sum_wide, sum_clamped, fate_fine, fate_inverted, fate_outside, fate_jumped
  use gimp_particle_pass, only: particle_pass
  use gimp_resort, only: sort_particles
  use gimp_engine_fixture, only: cloud_t, random_cloud, make_engine, read_cloud, node_sums, random_reals
  use gimp_text, only: text_of
  use gimp_check, only: begin_suite, end_suite, check, check_true
  implicit none(type, external)

  real(wp), parameter :: round_off = epsilon(1.0_wp)
  real(wp), parameter :: spacing = 0.5_wp !! a power of two would hide nothing: hinv = 2 must appear
  !> Nodes sum up to some 50 particles' shares of size 1 to 1000 (forces): relative to the largest of each field
  real(wp), parameter :: tolerance = 1.0e-13_wp
  integer :: seed = 7, dim, basis

  call begin_suite("passes")
  do dim = 1, 3
    do basis = basis_linear, basis_cpgimp
      call test_pass(dim, basis, 0.05_wp, 0.5_wp, 0.0_wp)
      call test_pass(dim, basis, 0.05_wp, 0.5_wp, 0.999_wp)
    end do
    call test_pass(dim, basis_cpgimp, 0.001_wp, 2.0_wp, 0.0_wp)
    ! blocks of 4 nodes and their neighbours end 7 cells on: half lengths of 2 leave room for half a cell of drift there
    call test_pass(dim, basis_cpgimp, 0.001_wp, 2.0_wp, merge(0.499_wp, 0.999_wp, dim == 3))
    call test_far_drift(dim, basis_ugimp)
    call test_fates(dim)
  end do
  do dim = 1, 3
    do basis = basis_bspline2, basis_bspline3
      call test_pass(dim, basis, 0.05_wp, 0.5_wp, 0.0_wp)
      call test_pass(dim, basis, 0.05_wp, 0.5_wp, 0.999_wp)
      call test_pass(dim, basis, 0.05_wp, 0.5_wp, 0.0_wp, open=.true.)
      call test_pass(dim, basis, 0.05_wp, 0.5_wp, 0.999_wp, open=.true.)
      call test_far_drift(dim, basis)
    end do
  end do
  do dim = 1, 3
    call test_pass(dim, basis_ddmp, 0.05_wp, 0.5_wp, 0.0_wp)
    call test_pass(dim, basis_ddmp, 0.05_wp, 0.5_wp, 0.999_wp)
    call test_pass(dim, basis_ddmp, 0.05_wp, 0.5_wp, 0.999_wp, open=.true.)
    call test_far_drift(dim, basis_ddmp)
  end do
  call test_wide_end(basis_cpgimp, 4.5_wp)
  call test_wide_end(basis_bspline3, 5.5_wp)
  call test_uniform_half()
  call test_renewed_domains()
  call end_suite()

contains

  function cells_of(dim) result(cells)
    integer, intent(in) :: dim
    integer :: cells(3)
    cells = 1
    cells(:dim) = merge(300, merge(40, 16, dim == 2), dim == 1)
  end function cells_of

  subroutine some_cloud(dim, short, long, cloud)
    integer, intent(in) :: dim
    real(wp), intent(in) :: short, long
    type(cloud_t), intent(out) :: cloud
    real(wp) :: low(3), high(3)
    low = 0.0_wp
    low(:dim) = 3.0_wp
    high = cells_of(dim) - 3.0_wp
    if (dim == 2) high(2) = 17.0_wp
    if (dim == 3) high(3) = 9.0_wp
    call random_cloud(dim, 400, low, high, short, long, seed, cloud)
    cloud%material(2::3) = 2
    cloud%x(1:dim, 5) = anint(cloud%x(1:dim, 5)) ! some exactly on nodes
  end subroutine some_cloud

  !> Spread a cloud over the whole box, some particles right on its sides
  subroutine fill_box(dim, cloud)
    integer, intent(in) :: dim
    type(cloud_t), intent(inout) :: cloud
    real(wp) :: low, high
    integer :: cells(3), k
    cells = cells_of(dim)
    do k = 1, dim
      low = minval(cloud%x(k, :))
      high = maxval(cloud%x(k, :))
      cloud%x(k, :) = (cloud%x(k, :) - low)/(high - low)*cells(k)
      cloud%x(k, 7::20) = 0.0_wp
      cloud%x(k, 8::20) = cells(k)
    end do
  end subroutine fill_box

  !> Let particles stray by up to `stray` cells without a sort; spare lanes follow their first lane
  subroutine let_stray(engine, stray, mark)
    type(engine_t), intent(inout) :: engine
    real(wp), intent(in) :: stray
    integer, intent(in) :: mark
    real(wp) :: u(3)
    integer :: c, l, d, number
    d = engine%grid%dim
    number = mark
    do c = 1, engine%particles%chunks
      do l = 1, lanes
        call random_reals(number, u)
        if (engine%particles%id(l, c) > 0) engine%particles%p(l, :d, c) = engine%particles%p(l, :d, c) + stray*u(:d)
        if (engine%particles%id(l, c) == 0) engine%particles%p(l, :d, c) = engine%particles%p(1, :d, c)
      end do
    end do
    if (engine%grid%open_degree > 0 .or. engine%basis == basis_ddmp) call keep_inside(engine)
  end subroutine let_stray

  !> Open knots end at the sides of the box
  subroutine keep_inside(engine)
    type(engine_t), intent(inout) :: engine
    integer :: g, c, k
    associate (p => engine%particles, edge => engine%grid%edge)
      do g = 1, size(p%groups)
        do c = p%groups(g)%first, p%groups(g)%last
          do k = 1, engine%grid%dim
            p%p(:, k, c) = min(max(p%p(:, k, c), -real(p%groups(g)%at(k)*edge(k), wp)), &
                               real(engine%grid%cells(k) - p%groups(g)%at(k)*edge(k), wp))
          end do
        end do
      end do
    end associate
  end subroutine keep_inside

  !> Twin engines, one with the list kernel everywhere: they give, take, and do both at once
  subroutine test_pass(dim, basis, short, long, stray, open)
    integer, intent(in) :: dim, basis
    real(wp), intent(in) :: short, long, stray
    logical, intent(in), optional :: open !! knots, with particles at all sides of the box
    type(engine_t), target :: fast, list
    type(cloud_t) :: cloud, after_fast, after_list
    type(pass_t) :: pass
    real(wp), allocatable :: raw_fast(:, :, :), raw_list(:, :, :)
    character(len=:), allocatable :: which
    integer :: mark
    which = ", "//text_of(dim)//"D, basis "//text_of(basis)//", half lengths to "//text_of(long)//", drift "//text_of(stray)
    call some_cloud(dim, short, long, cloud)
    if (present(open)) call fill_box(dim, cloud)
    call make_engine(dim, basis, cells_of(dim), spacing, cloud, fast, with_force=.true.)
    call make_engine(dim, basis, cells_of(dim), spacing, cloud, list, with_force=.true.)
    list%list_kernel = .true.
    if (present(open)) then
      which = which//", open knots"
      fast%grid%open_degree = spline_degree(basis)
      list%grid%open_degree = spline_degree(basis)
    end if
    call sort_particles(fast)
    call sort_particles(list)
    call check_true(fast%table%blocks > 3, "several blocks"//which)
    mark = seed
    call let_stray(fast, stray, mark)
    call let_stray(list, stray, mark)

    pass = pass_t(momentum=.true., force=.true.)
    call particle_pass(fast, pass)
    call particle_pass(list, pass)
    call check_true(all(fast%fate(1, :) == fate_fine), "no particle is in trouble"//which)
    call node_sums(fast, raw_fast)
    call node_sums(list, raw_list)
    call compare_nodes("given", raw_fast, raw_list, which)
    call check_totals(dim, cloud, raw_fast, which)
    if (long > 0.5_wp) then
      call check_true(fast%sums(sum_wide, 1) > 0.0_dp, "wide chunks are counted"//which)
      call check_true(fast%spill%n > 0, "and spill beyond the pads"//which)
    else if (stray < 0.5_wp) then
      call check(real(sum(fast%sums(sum_wide, :)), wp), 0.0_wp, 0.0_wp, "nothing is wide"//which)
    end if

    call fill_grid(fast, list)
    pass = pass_t(velocity=.true., position=.true., strain=.true., dt=0.01_wp, dt_strain=0.02_wp, kick=0.01_wp, flip=0.7_wp)
    call particle_pass(fast, pass)
    call particle_pass(list, pass)
    call read_cloud(fast, after_fast)
    call read_cloud(list, after_list)
    call compare_particles("taken", after_fast, after_list, which)
    call check(fast%sums(sum_external, 1), list%sums(sum_external, 1), 1.0e-12_wp, "work of forces"//which)
    call check_true(any(abs(after_fast%f - cloud%f) > 1.0e-4_wp) .and. any(abs(after_fast%v - cloud%v) > 1.0e-2_wp), &
                    "particles did move and strain"//which)

    ! take and give in one pass, with the weights of the take (MUSL, USF) and with those of the new positions
    call particle_pass(fast, pass_t(momentum=.true.))
    call particle_pass(list, pass_t(momentum=.true.))
    call particle_pass(fast, pass_t(velocity=.true., momentum=.true., old_weights=.true., kick=0.01_wp))
    call particle_pass(list, pass_t(velocity=.true., momentum=.true., old_weights=.true., kick=0.01_wp))
    call node_sums(fast, raw_fast)
    call node_sums(list, raw_list)
    call compare_nodes("given with old weights", raw_fast, raw_list, which)
    pass = pass_t(position=.true., strain=.true., moved_by_second=.true., momentum=.true., force=.true., dt=0.01_wp, &
                  dt_strain=0.01_wp)
    call particle_pass(fast, pass)
    call particle_pass(list, pass)
    call node_sums(fast, raw_fast)
    call node_sums(list, raw_list)
    call compare_nodes("given after a move", raw_fast, raw_list, which)
    call read_cloud(fast, after_fast)
    call read_cloud(list, after_list)
    call compare_particles("taken and given", after_fast, after_list, which)
  end subroutine test_pass

  subroutine compare_nodes(what, a, b, which)
    character(len=*), intent(in) :: what, which
    real(wp), intent(in) :: a(:, :, :), b(:, :, :)
    integer :: f
    do f = 1, nf
      call check(maxval(abs(a(f, :, :) - b(f, :, :))), 0.0_wp, tolerance*max(1.0_wp, maxval(abs(b(f, :, :)))), &
                 what//": field "//text_of(f)//" of both kernels"//which)
    end do
  end subroutine compare_nodes

  subroutine compare_particles(what, a, b, which)
    character(len=*), intent(in) :: what, which
    type(cloud_t), intent(in) :: a, b
    call check(maxval(abs(a%x - b%x)), 0.0_wp, 1.0e-13_wp*maxval(abs(b%x)), what//": positions"//which)
    call check(maxval(abs(a%v - b%v)), 0.0_wp, tolerance, what//": velocities"//which)
    ! short domains divide a difference of weights by 2 l >= 0.002: the list form loses that much in the gradients
    call check(maxval(abs(a%f - b%f)), 0.0_wp, 10*tolerance, what//": deformation"//which)
  end subroutine compare_particles

  !> The grid has all mass, momentum and kinetic energy of the particles; internal forces add up to nothing, given ones to
  !> themselves
  subroutine check_totals(dim, cloud, raw, which)
    integer, intent(in) :: dim
    type(cloud_t), intent(in) :: cloud
    real(wp), intent(in) :: raw(:, :, :)
    character(len=*), intent(in) :: which
    real(wp) :: total(nf), kinetic
    integer :: f, k
    do f = 1, nf
      total(f) = sum(raw(f, :, :))
    end do
    kinetic = 0.5_wp*sum(cloud%mass*sum(cloud%v**2, 1))
    call check(total(4), sum(cloud%mass), 1.0e-12_wp*sum(cloud%mass), "mass"//which)
    call check(total(8), kinetic, 1.0e-12_wp*kinetic, "kinetic energy by weights"//which)
    do k = 1, dim
      call check(total(k), sum(cloud%mass*cloud%v(k, :)), 1.0e-12_wp*sum(cloud%mass), "momentum"//which)
      call check(total(4 + k), sum(cloud%force(k, :)), 1.0e-13_wp*sum(abs(raw(4 + k, :, :))) + 1.0e-12_wp*cloud%n, &
                 "internal forces add up to zero, given ones to themselves"//which)
    end do
    call check(sum(abs(raw(dim + 1:3, :, :))) + sum(abs(raw(5 + dim:7, :, :))), 0.0_wp, 0.0_wp, &
               "axes that do not exist stay empty"//which)
  end subroutine check_totals

  !> The same random nodal velocities and changes on both engines
  subroutine fill_grid(a, b)
    type(engine_t), intent(inout) :: a, b
    real(wp), allocatable :: numbers(:)
    integer :: d
    allocate (numbers(size(a%g)))
    call random_reals(seed, numbers)
    a%g = reshape(numbers, shape(a%g))
    d = a%grid%dim
    a%g(d + 1:4, :, :) = 0.0_wp
    a%g(5 + d:, :, :) = 0.0_wp
    b%g = a%g
  end subroutine fill_grid

  !> A particle more than a cell beyond its block's pad takes the list kernel, and one near the end asks for a sort. Between
  !> 2.2 and 2.3 cells of drift, all that blocks of 4 nodes allow (place 4.3, half length 0.3, neighbours end at 7)
  subroutine test_far_drift(dim, basis)
    integer, intent(in) :: dim, basis
    type(engine_t) :: engine
    type(cloud_t) :: cloud
    real(wp), allocatable :: raw(:, :, :)
    real(wp) :: offset
    integer :: k
    do k = 1, 2
      offset = merge(2.25_wp, -2.25_wp, k == 1)
      if (k == 1 .and. dim == 3 .and. basis == basis_bspline2) offset = 1.75_wp ! half lengths of 0.5
      if (k == 1 .and. dim == 3 .and. (basis == basis_bspline3 .or. basis == basis_ddmp)) cycle ! supports of 4 nodes end before the list kernel is needed
      call some_cloud(dim, 0.2_wp, 0.3_wp, cloud)
      call make_engine(dim, basis, cells_of(dim), spacing, cloud, engine, with_force=.true.)
      call sort_particles(engine)
      engine%particles%p(:, 1, :) = engine%particles%p(:, 1, :) + offset
      call particle_pass(engine, pass_t(momentum=.true., force=.true.))
      call check_true(all(engine%fate(1, :) == fate_fine), "a drift of two cells is served")
      call check_true(sum(engine%sums(sum_wide, :)) > 0.0_dp, "by the list kernel where the pad ends")
      call check_true(any(engine%restless), "and a sort is asked for")
      call node_sums(engine, raw)
      call check_totals(dim, cloud, raw, ", drift of two cells, "//text_of(dim)//"D")
    end do
    engine%particles%p(:, 1, :) = engine%particles%p(:, 1, :) - offset
    call particle_pass(engine, pass_t(momentum=.true.))
    call check_true(.not. any(engine%restless), "right after a sort nobody asks for one, "//text_of(dim)//"D")
    call check_true(.not. any(engine%drifted), "and the outer layer of the pads is not in use")
  end subroutine test_far_drift

  !> Impossible states are noted with what, chunk and lane, and do not reach the grid
  subroutine test_fates(dim)
    integer, intent(in) :: dim
    type(engine_t) :: engine
    type(cloud_t) :: cloud
    real(wp) :: keep
    integer :: c, b
    call some_cloud(dim, 0.2_wp, 0.3_wp, cloud)
    call make_engine(dim, basis_ugimp, cells_of(dim), spacing, cloud, engine)
    call sort_particles(engine)
    engine%allowed_low(:dim) = 0.0_wp
    engine%allowed_high(:dim) = cells_of(dim)
    b = (engine%table%blocks + 1)/2
    c = engine%particles%groups(engine%particles%block_group(b))%first
    keep = engine%particles%p(1, 1, c)
    engine%particles%p(1, 1, c) = keep + 1000.0_wp
    call expect(engine, [fate_outside, c, 1], b, "a particle outside the box")
    engine%particles%p(1, 1, c) = keep + merge(-1.0_wp, 1.0_wp, engine%table%block_at(1, b) > 0)*(1.5_wp*engine%grid%edge(1) + 8)
    if (dim < 3) call expect(engine, [fate_jumped, c, 1], b, "a particle that jumped over a block")
    engine%particles%p(1, 1, c) = keep
    engine%g = 0.0_wp
    engine%particles%p(1, engine%particles%deformation%first, c) = -1.0_wp
    call particle_pass(engine, pass_t(strain=.true., dt_strain=0.1_wp))
    call check_true(all(engine%fate(:, b) == [fate_inverted, c, 1]), "an inverted particle is named, "//text_of(dim)//"D")
  end subroutine test_fates

  subroutine expect(engine, fate, b, what)
    type(engine_t), intent(inout) :: engine
    integer, intent(in) :: fate(3), b
    character(len=*), intent(in) :: what
    call particle_pass(engine, pass_t(momentum=.true.))
    call check_true(all(engine%fate(:, b) == fate), what//" is named")
    call check(count(engine%fate(1, :) /= fate_fine), 1, "and it alone")
  end subroutine expect

  !> A wide domain (or spline) whose far end comes within half a cell (the longest step) of the end of the neighbours asks for a sort in time
  subroutine test_wide_end(basis, near)
    integer, intent(in) :: basis
    real(wp), intent(in) :: near !! that place [cells from the start of the block]
    type(engine_t) :: engine
    type(cloud_t) :: cloud
    call some_cloud(3, 2.0_wp, 2.0_wp, cloud)
    call make_engine(3, basis, cells_of(3), spacing, cloud, engine)
    call sort_particles(engine)
    engine%particles%p(:, 1, 1) = near - 0.05_wp ! for a wide domain as far as it can be after a sort
    call particle_pass(engine, pass_t(momentum=.true.))
    call check_true(.not. engine%restless(1), "a wide domain right after a sort is at rest")
    engine%particles%p(:, 1, 1) = near + 0.05_wp
    call particle_pass(engine, pass_t(momentum=.true.))
    call check_true(engine%restless(1), "a wide domain near the end of the neighbours asks for a sort")
    engine%particles%p(:, 1, 1) = near + 0.45_wp
    call particle_pass(engine, pass_t(momentum=.true.))
    call check_true(all(engine%fate(1, :) == fate_fine), "and there is room for the step before it")
  end subroutine test_wide_end

  !> Half lengths that all share give the same as half lengths stored with each particle
  subroutine test_uniform_half()
    type(engine_t) :: stored, shared
    type(cloud_t) :: cloud
    real(wp), allocatable :: a(:, :, :), b(:, :, :)
    call some_cloud(2, 0.25_wp, 0.25_wp, cloud)
    call make_engine(2, basis_ugimp, cells_of(2), spacing, cloud, stored)
    call make_engine(2, basis_ugimp, cells_of(2), spacing, cloud, shared, uniform=.true.)
    call sort_particles(stored)
    call sort_particles(shared)
    call particle_pass(stored, pass_t(momentum=.true., force=.true.))
    call particle_pass(shared, pass_t(momentum=.true., force=.true.))
    call node_sums(stored, a)
    call node_sums(shared, b)
    call check_true(all(a == b), "shared half lengths give the same bits")
  end subroutine test_uniform_half

  !> A pass that gives at new positions renews the domains of cpgimp from the deformation: here a rotated stretch
  subroutine test_renewed_domains()
    type(engine_t) :: engine
    type(cloud_t) :: cloud, after
    call some_cloud(2, 0.1_wp, 0.1_wp, cloud)
    cloud%f(:, 1) = [0.0_wp, -2.0_wp, 0.0_wp, 3.0_wp, 0.0_wp, 0.0_wp, 0.0_wp, 0.0_wp, 1.0_wp] ! stretch (3, 2), then 90 degrees
    call make_engine(2, basis_cpgimp, cells_of(2), spacing, cloud, engine)
    engine%domain_rule = domain_stretch
    call sort_particles(engine)
    call particle_pass(engine, pass_t(momentum=.true.))
    call read_cloud(engine, after)
    call check(after%half(:2, 1), [0.3_wp, 0.2_wp], 4*round_off, "domains follow the stretch")
    call check(real(sum(engine%sums(sum_clamped, :)), wp), 0.0_wp, 0.0_wp, "none is clamped")
  end subroutine test_renewed_domains

end program test_passes
