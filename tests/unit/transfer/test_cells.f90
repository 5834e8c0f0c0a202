!> Sums over cells: nothing is lost wherever particles strayed, and what methods against locking make of them keeps its promises
program test_cells
  use gimp_kinds, only: wp, lanes
  use gimp_grid, only: nf => fields_per_node
  use gimp_basis, only: basis_linear, basis_ugimp, basis_cpgimp, basis_bspline2, basis_bspline3, basis_cpdi
  use gimp_engine, only: engine_t, pass_t, anti_none, anti_f_bar, anti_b_bar, anti_cell_stress
  use gimp_particle_pass, only: particle_pass, allot_spills
  use gimp_list_kernel, only: order_spill
  use gimp_cells, only: give_to_cells, take_from_cells, sum_cells
  use gimp_cell_pass, only: rates_to_cells, stress_to_cells
  use gimp_chunk_state, only: chunk_deformation, chunk_law_deformation
  use gimp_tensor, only: multiply, inverse, determinant
  use gimp_resort, only: sort_particles
  use gimp_engine_fixture, only: cloud_t, random_cloud, make_engine, node_sums, random_reals, identity9
  use gimp_material, only: most_states
  use gimp_text, only: text_of
  use gimp_check, only: begin_suite, end_suite, check, check_true
  implicit none(type, external)

  real(wp), parameter :: spacing = 0.5_wp
  integer, parameter :: cells(3, 3) = reshape([200, 1, 1, 30, 30, 1, 13, 12, 11], [3, 3])
  integer, parameter :: bases(6) = [basis_linear, basis_ugimp, basis_cpgimp, basis_bspline2, basis_bspline3, basis_cpdi]
  integer :: seed = 3, dim, k

  call begin_suite("cells")
  do dim = 1, 3
    do k = 1, size(bases)
      call test_sums(dim, bases(k), 0.0_wp, .false.)
      call test_sums(dim, bases(k), 0.99_wp, .false.) ! up to the drift that pads hold
      call test_sums(dim, bases(k), 0.99_wp, .true.)
      call test_work(dim, bases(k))
      call test_uniform(dim, bases(k))
    end do
    call test_sums(dim, basis_ugimp, 2.5_wp, .false.) ! far beyond the pads
  end do
  call test_plain_ratio()
  call end_suite()

contains

  subroutine new_engine(dim, basis, margin, anti, engine)
    integer, intent(in) :: dim, basis, anti
    real(wp), intent(in) :: margin !! particles keep away so far from the sides [cells]
    type(engine_t), intent(out) :: engine
    type(cloud_t) :: cloud
    real(wp) :: low(3), high(3)
    low = 0.0_wp
    high = 0.0_wp
    low(:dim) = margin
    high(:dim) = real(cells(:dim, dim), wp) - margin
    call random_cloud(dim, 300, low, high, 0.1_wp, 0.4_wp, seed, cloud)
    cloud%material(3::3) = 2
    call make_engine(dim, basis, cells(:, dim), spacing, cloud, engine, anti_locking=anti)
  end subroutine new_engine

  !> Every cell holds the sum over its particles, as a table over the box has it
  subroutine test_sums(dim, basis, stray, periodic)
    integer, intent(in) :: dim, basis
    real(wp), intent(in) :: stray
    logical, intent(in) :: periodic
    type(engine_t), target :: engine
    real(wp) :: table(2, cells(1, dim), cells(2, dim), cells(3, dim)), values(lanes, nf), u(3), worst
    character(len=:), allocatable :: which
    integer :: at(3), b, c, g, l, turn
    which = ", "//text_of(dim)//"D, basis "//text_of(basis)//", drift "//text_of(stray)
    call new_engine(dim, basis, merge(0.0_wp, 3.5_wp, periodic), anti_f_bar, engine)
    if (periodic) engine%grid%periodic(:dim) = .true.
    call sort_particles(engine)
    call allot_spills(engine)
    table = 0.0_wp
    worst = 0.0_wp
    do turn = 1, 2
      do b = 1, engine%table%blocks
        if (turn == 1) engine%pad(:, :, b) = 0.0_wp
        do g = engine%particles%block_group(b), engine%particles%block_group(b + 1) - 1
          do c = engine%particles%groups(g)%first, engine%particles%groups(g)%last
            associate (p => engine%particles%p(:, :, c))
              values = 0.0_wp
              values(:, 1) = p(:, engine%particles%mass%first)
              values(:, nf) = p(:, engine%particles%mass%first)*p(:, dim + 1)
              if (turn == 1) then
                do l = 1, lanes
                  call random_reals(seed, u)
                  engine%particles%p(l, :dim, c) = engine%particles%p(l, :dim, c) + stray*u(:dim)
                end do
                call give_to_cells(engine, b, engine%particles%p(:, :dim, c), values, engine%pad(:, :, b))
              end if
              if (turn == 2) call take_from_cells(engine, b, engine%particles%p(:, :dim, c), values)
            end associate
            do l = 1, lanes
              if (engine%particles%id(l, c) == 0) cycle
              at = 1
              at(:dim) = 1 + floor(engine%particles%p(l, :dim, c)) + engine%table%block_at(:dim, b)*engine%grid%edge(:dim)
              if (periodic) at = 1 + modulo(at - 1, cells(:, dim))
              associate (cell => table(:, at(1), at(2), at(3)))
                if (turn == 1) cell = cell + values(l, [1, nf])
                if (turn == 2) worst = max(worst, maxval(abs(values(l, [1, nf]) - cell)))
              end associate
            end do
          end do
        end do
      end do
      if (turn == 1) then
        call order_spill(engine%spilled, engine%spill)
        call sum_cells(engine)
        call check_true(engine%spill%n == 0, "nothing is left for nodes"//which)
      end if
    end do
    call check(worst, 0.0_wp, 1.0e-13_wp, "sums of cells"//which) ! some ten particles of mass below 2.5 in a cell
  end subroutine test_sums

  !> B-bar: forces on nodes times velocities of nodes are minus the work of the stresses on the evened rates; so says the adjoint. What
  !> other methods make of their forces is not.
  subroutine test_work(dim, basis)
    integer, intent(in) :: dim, basis
    type(engine_t), target :: engine
    real(wp), allocatable :: raw(:, :, :)
    real(wp) :: f_old(lanes, 9), f_new(lanes, 9), f_back(lanes, 9), step(lanes, 9), tau(lanes, 6), speed2(lanes), history(lanes, most_states), work(lanes)
    real(wp), allocatable :: stress(:, :, :), old(:, :, :)
    real(wp) :: of_nodes, of_particles, size_of_work
    integer :: c, g, slot
    call new_engine(dim, basis, 3.5_wp, anti_b_bar, engine)
    call sort_particles(engine)
    call stress_to_cells(engine)
    call particle_pass(engine, pass_t(force=.true.))
    call node_sums(engine, raw)
    allocate (stress(lanes, 6, engine%particles%chunks), old(lanes, 9, engine%particles%chunks))
    history = 0.0_wp
    do g = 1, size(engine%particles%groups)
      do c = engine%particles%groups(g)%first, engine%particles%groups(g)%last
        call chunk_law_deformation(engine%particles, c, f_old)
        call engine%laws(engine%particles%groups(g)%material)%law%kirchhoff(f_old, history, tau, speed2)
        stress(:, :, c) = tau
        old(:, :, c) = f_old
      end do
    end do
    engine%f_update = 2
    engine%g = 0.0_wp
    do slot = 1, engine%table%slots
      call random_velocities(dim, engine%g(:, :, slot))
    end do
    of_nodes = sum(raw(5:7, :, :)*engine%g(1:3, :, :))
    call rates_to_cells(engine, pass_t(strain=.true., dt_strain=1.0_wp))
    call particle_pass(engine, pass_t(strain=.true., dt_strain=1.0_wp)) ! dF - 1 = L
    of_particles = 0.0_wp
    size_of_work = 0.0_wp
    do c = 1, engine%particles%chunks
      call chunk_law_deformation(engine%particles, c, f_new)
      call inverse(old(:, :, c), f_back)
      call multiply(f_new, f_back, step)
      step = step - spread(identity9, 1, lanes)
      work = stress(:, 1, c)*step(:, 1) + stress(:, 2, c)*step(:, 5) + stress(:, 3, c)*step(:, 9) &
        + stress(:, 4, c)*(step(:, 2) + step(:, 4)) + stress(:, 5, c)*(step(:, 6) + step(:, 8)) + stress(:, 6, c)*(step(:, 3) + step(:, 7))
      of_particles = of_particles + sum(work*engine%particles%p(:, engine%particles%volume%first, c))
      size_of_work = size_of_work + sum(abs(work)*engine%particles%p(:, engine%particles%volume%first, c))
    end do
    call check(of_nodes/size_of_work, -of_particles/size_of_work, 1.0e-13_wp, "work of nodes and particles, "//text_of(dim)//"D, basis "//text_of(basis))
    call check_true(abs(of_particles) > 1.0e-4_wp*size_of_work, "there is work, "//text_of(dim)//"D, basis "//text_of(basis))
  end subroutine test_work

  !> Small enough that no particle turns inside out
  subroutine random_velocities(dim, g)
    integer, intent(in) :: dim
    real(wp), intent(inout) :: g(:, :)
    integer :: i
    do i = 1, size(g, 2)
      call random_reals(seed, g(1:dim, i))
    end do
    g(1:dim, :) = 0.02_wp*g(1:dim, :)
  end subroutine random_velocities

  !> A stress that is the same everywhere gives the forces that it would give without any average
  subroutine test_uniform(dim, basis)
    integer, intent(in) :: dim, basis
    integer, parameter :: methods(4) = [anti_none, anti_f_bar, anti_b_bar, anti_cell_stress]
    type(engine_t), target :: engine
    real(wp), allocatable :: raw(:, :, :), plain(:, :, :)
    integer :: m, mark, first
    mark = seed
    do m = 1, size(methods)
      seed = mark
      call new_engine(dim, basis, 3.5_wp, methods(m), engine)
      engine%laws(2) = engine%laws(1)
      call set_all(engine, engine%particles%deformation%first)
      first = engine%particles%evened%first
      if (first > 0) call set_all(engine, first)
      call sort_particles(engine)
      if (m > 2) call stress_to_cells(engine)
      call particle_pass(engine, pass_t(momentum=.true., force=.true.))
      call node_sums(engine, raw)
      if (m == 1) plain = raw
      call check_true(maxval(abs(raw - plain)) < 1.0e-13_wp*maxval(abs(plain)), "uniform stress, " &
                      //text_of(dim)//"D, basis "//text_of(basis)//", method "//text_of(methods(m)))
    end do
  end subroutine test_uniform

  !> The same gradient for all particles
  subroutine set_all(engine, first)
    type(engine_t), intent(inout) :: engine
    integer, intent(in) :: first !! component of the chunks where it begins
    integer :: d, i, j
    d = engine%grid%dim
    do i = 1, d
      do j = 1, d
        engine%particles%p(:, first + d*(i - 1) + j - 1, :) = merge(1.1_wp, 0.07_wp*i - 0.02_wp*j, i == j)
      end do
    end do
  end subroutine set_all

  !> F-bar: in a cell all particles have the same change of volume, their mean; alone in a cell a particle keeps its own
  subroutine test_plain_ratio()
    type(engine_t), target :: engine
    real(wp) :: f(lanes, 9), before(lanes), after(lanes), even_before(lanes), even_after(lanes)
    real(wp), allocatable :: old(:, :)
    integer :: c, slot, changed
    call new_engine(2, basis_ugimp, 3.5_wp, anti_f_bar, engine)
    call sort_particles(engine)
    engine%f_update = 2
    engine%g = 0.0_wp
    do slot = 1, engine%table%slots
      call random_velocities(2, engine%g(:, :, slot))
    end do
    allocate (old(lanes, engine%particles%chunks))
    do c = 1, engine%particles%chunks
      call chunk_deformation(engine%particles, c, f)
      call determinant(f, before)
      old(:, c) = before
    end do
    call rates_to_cells(engine, pass_t(strain=.true., dt_strain=1.0_wp))
    call particle_pass(engine, pass_t(strain=.true., dt_strain=1.0_wp))
    changed = 0
    do c = 1, engine%particles%chunks
      call chunk_deformation(engine%particles, c, f)
      call determinant(f, after)
      call chunk_law_deformation(engine%particles, c, f)
      call determinant(f, even_after)
      even_before = old(:, c) ! both began alike
      changed = changed + count(abs(even_after/even_before - after/old(:, c)) > 1.0e-6_wp .and. engine%particles%id(:, c) > 0)
    end do
    call check_true(changed > 20 .and. changed < 300, "particles that share a cell change, those alone do not")
  end subroutine test_plain_ratio

end program test_cells
