!> Loads: the total force is exact after stretch and rotation, nodes get all of it with its moment, and work is force times way
program test_loads
  use gimp_kinds, only: wp, dp
  use gimp_grid, only: nodes_per_block, nf => fields_per_node
  use gimp_basis, only: basis_ugimp
  use gimp_engine, only: engine_t
  use gimp_resort, only: sort_particles
  use gimp_loads, only: load_t, loads_t, gravity_t, gravity_at, collect_loads, add_loads, work_of_loads, load_traction, &
    load_pressure, load_point
  use gimp_engine_fixture, only: cloud_t, lattice_cloud, make_engine
  use gimp_text, only: text_of
  use gimp_check, only: begin_suite, end_suite, check, check_true
  implicit none(type, external)

  real(wp), parameter :: spacing = 0.5_wp
  integer :: dim

  call begin_suite("loads")
  do dim = 1, 3
    call test_pressure(dim)
    call test_traction(dim)
  end do
  call test_closed_surface()
  call test_point_force()
  call test_gravity()
  call test_many()
  call end_suite()

contains

  !> A block of 3 cells an axis in the middle of the box, deformed as one by F about its middle; `faces` marks the particles at
  !> the outside with outward normal +x (bit 1), as the first face load (or the second: six bits further)
  subroutine block_of_particles(dim, f, shift, engine)
    integer, intent(in) :: dim, shift
    real(wp), intent(in) :: f(3, 3)
    type(engine_t), intent(out) :: engine
    type(cloud_t) :: cloud
    real(wp) :: middle(3), right
    integer :: i, k
    call lattice_cloud(dim, [12, 12, 12], [3, 3, 3], 2, spacing, 1000.0_wp, cloud)
    middle = 0.0_wp
    middle(:dim) = 13.5_wp
    right = maxval(cloud%x(1, :))
    do i = 1, cloud%n
      if (cloud%x(1, i) > right - 0.01_wp) cloud%faces(i) = real(ishft(2, 6*shift), wp)
      cloud%x(:, i) = middle + matmul(f, cloud%x(:, i) - middle)
      do k = 1, 3
        cloud%f(3*k - 2:3*k, i) = f(k, :)
      end do
    end do
    call make_engine(dim, basis_ugimp, merge([27, 27, 27], [1, 1, 1], [1, 2, 3] <= dim), spacing, cloud, engine, &
                     with_faces=.true.)
    call sort_particles(engine)
  end subroutine block_of_particles

  !> Stretch and rotation in the space of that dimension
  function some_deformation(dim) result(f)
    integer, intent(in) :: dim
    real(wp) :: f(3, 3), a, b
    a = 0.7_wp
    b = -0.4_wp
    f = reshape([1.3_wp, 0.2_wp, -0.1_wp, 0.15_wp, 0.8_wp, 0.1_wp, 0.05_wp, -0.2_wp, 1.1_wp], [3, 3])
    if (dim < 3) then
      f(3, :) = [0.0_wp, 0.0_wp, 1.0_wp]
      f(:2, 3) = 0.0_wp
    end if
    if (dim == 1) f = reshape([1.3_wp, 0.0_wp, 0.0_wp, 0.0_wp, 1.0_wp, 0.0_wp, 0.0_wp, 0.0_wp, 1.0_wp], [3, 3])
    if (dim > 1) f = matmul(reshape([cos(a), sin(a), 0.0_wp, -sin(a), cos(a), 0.0_wp, 0.0_wp, 0.0_wp, 1.0_wp], [3, 3]), f)
    if (dim > 2) f = matmul(reshape([1.0_wp, 0.0_wp, 0.0_wp, 0.0_wp, cos(b), sin(b), 0.0_wp, -sin(b), cos(b)], [3, 3]), f)
  end function some_deformation

  !> Area vector of the deformed +x face of the block: cross product of its deformed edges, lengths beyond the dimension one
  function area_vector(dim, f) result(area)
    integer, intent(in) :: dim
    real(wp), intent(in) :: f(3, 3)
    real(wp) :: area(3), u(3), w(3)
    u = f(:, 2)
    w = f(:, 3)
    if (dim > 1) u = u*3*spacing
    if (dim > 2) w = w*3*spacing
    area = [u(2)*w(3) - u(3)*w(2), u(3)*w(1) - u(1)*w(3), u(1)*w(2) - u(2)*w(1)]
  end function area_vector

  !> Nodes have the force and moment of the points (tents reproduce linear fields), and the work of a linear nodal velocity is
  !> that of the points moving with it
  subroutine check_nodes(engine, loads, total, what)
    type(engine_t), intent(inout) :: engine
    type(loads_t), intent(inout) :: loads
    real(wp), intent(in) :: total(3)
    character(len=*), intent(in) :: what
    real(wp), allocatable :: raw(:, :, :)
    real(wp) :: sums(3), x(3), moment(3), expected(3), work, l(3, 3), x_kind(3), scale
    integer :: s, place, q, lost, node(3)
    real(dp) :: turned(3)
    allocate (raw(nf, nodes_per_block, engine%table%slots), source=0.0_wp)
    lost = 0
    engine%g = 0.0_wp
    engine%g(4, :, :) = 1.0_wp ! every node has mass
    call add_loads(loads, engine, engine%table%slots, engine%g, 0.5_wp, raw, lost, turned)
    call check(lost, 0, what//": no point lies on a node that does not exist")
    call check(maxval(abs(turned)), 0.0_dp, 0.0_dp, what//": without planes of symmetry nothing is turned around")
    l = reshape([0.3_wp, -0.2_wp, 0.1_wp, 0.4_wp, 0.5_wp, -0.6_wp, 0.7_wp, 0.2_wp, -0.9_wp], [3, 3])
    sums = 0.0_wp
    moment = 0.0_wp
    do s = 1, engine%table%slots
      do place = 1, nodes_per_block
        node = [modulo(place - 1, engine%grid%edge(1)), modulo((place - 1)/engine%grid%edge(1), engine%grid%edge(2)), &
                (place - 1)/(engine%grid%edge(1)*engine%grid%edge(2))] + engine%table%slot_at(:, s)*engine%grid%edge
        x = node
        sums = sums + raw(5:7, place, s)
        moment = moment + cross(x, raw(5:7, place, s))
        engine%g(1:3, place, s) = matmul(l, x) + [1.0_wp, 2.0_wp, 3.0_wp]
        engine%g(5:7, place, s) = 2.0_wp ! the change in the step: the mean velocity is one less
      end do
    end do
    expected = 0.0_wp
    work = 0.0_wp
    scale = 0.0_wp
    do q = 1, loads%n
      x_kind = loads%x(:, q)
      expected = expected + cross(x_kind, loads%f(:, q))
      work = work + 0.25_wp*dot_product(loads%f(:, q), matmul(l, x_kind) + [0.0_wp, 1.0_wp, 2.0_wp])
      scale = scale + sum(abs(loads%f(:, q)))
    end do
    call check(sums, total, 1.0e-13_wp*scale, what//": nodal forces add up to the load")
    call check(moment, expected, 1.0e-12_wp*scale, what//": and have its moment")
    call check(real(work_of_loads(loads, engine, engine%table%slots, engine%g, 0.25_wp, 0.5_wp), wp), work, 1.0e-12_wp*scale, &
               what//": work of a linear velocity")
    call check_lean_nodes(engine, loads, total, scale, what)
  end subroutine check_nodes

  !> Where some corners of a cell have no mass the others take the whole force; where none has, the loss is counted
  subroutine check_lean_nodes(engine, loads, total, scale, what)
    type(engine_t), intent(inout) :: engine
    type(loads_t), intent(inout) :: loads
    real(wp), intent(in) :: total(3), scale
    character(len=*), intent(in) :: what
    real(wp), allocatable :: raw(:, :, :)
    real(wp) :: sums(3)
    integer :: k, lost
    real(dp) :: turned(3)
    allocate (raw(nf, nodes_per_block, engine%table%slots), source=0.0_wp)
    engine%g(4, :, :) = 0.0_wp
    engine%g(4, 1:nodes_per_block:2, :) = 1.0_wp ! every second node along x
    lost = 0
    call add_loads(loads, engine, engine%table%slots, engine%g, 0.5_wp, raw, lost, turned)
    call check(lost, 0, what//": every second node is enough")
    do k = 1, 3
      sums(k) = sum(raw(4 + k, :, :))
    end do
    call check(sums, total, 1.0e-13_wp*scale, what//": lean nodes take the whole load")
    call check(maxval(abs(raw(5:7, 2:nodes_per_block:2, :))), 0.0_wp, 0.0_wp, what//": nodes without mass take none")
    raw = 0.0_wp
    lost = 0
    call add_loads(loads, engine, engine%table%slots, engine%g, 2.0_wp, raw, lost, turned)
    call check(lost, loads%n, what//": without any mass every point is counted as lost")
    call check(maxval(abs(raw)), 0.0_wp, 0.0_wp, what//": and nothing is added")
  end subroutine check_lean_nodes

  pure function cross(u, w) result(c)
    real(wp), intent(in) :: u(3), w(3)
    real(wp) :: c(3)
    c = [u(2)*w(3) - u(3)*w(2), u(3)*w(1) - u(1)*w(3), u(1)*w(2) - u(2)*w(1)]
  end function cross

  !> A pressure on the straight +x face is -p A n of the deformed face (Nanson), to round-off
  subroutine test_pressure(dim)
    integer, intent(in) :: dim
    real(wp), parameter :: p = 7.0_wp
    type(engine_t) :: engine
    type(loads_t) :: loads
    real(wp) :: f(3, 3), total(3)
    integer :: round
    do round = 1, 2
      f = some_deformation(dim)
      if (round == 1) f = reshape([1, 0, 0, 0, 1, 0, 0, 0, 1], [3, 3])
      call block_of_particles(dim, f, 0, engine)
      if (allocated(loads%load)) deallocate (loads%load)
      allocate (loads%load(1))
      loads%load(1)%kind = load_pressure
      loads%load(1)%pressure = p
      call collect_loads(loads, engine, 0.0_wp)
      total = -p*area_vector(dim, f)
      call check(sum(loads%f(:, :loads%n), 2), total, 1.0e-13_wp*p*norm2(area_vector(dim, f)), &
                 "pressure is -p A n, "//text_of(dim)//"D")
      if (round == 1) call check(total(1), -p*(3*spacing)**(dim - 1), 1.0e-13_wp, "of the reference face at first")
      call check_nodes(engine, loads, total, "pressure, "//text_of(dim)//"D")
    end do
  end subroutine test_pressure

  !> A traction is per present area and keeps its direction; it is the second face load here, and grows with a ramp
  subroutine test_traction(dim)
    integer, intent(in) :: dim
    real(wp), parameter :: t(3) = [2.0_wp, -1.0_wp, 0.5_wp]
    type(engine_t) :: engine
    type(loads_t) :: loads
    real(wp) :: f(3, 3), total(3)
    f = some_deformation(dim)
    call block_of_particles(dim, f, 1, engine)
    allocate (loads%load(2))
    loads%load(1)%kind = load_pressure
    loads%load(1)%pressure = 1.0e6_wp ! no particle carries its mark
    loads%load(2)%kind = load_traction
    loads%load(2)%place = 1
    loads%load(2)%vector = merge(t, 0.0_wp, [1, 2, 3] <= dim)
    loads%load(2)%table%ramp_time = 2.0_wp
    call collect_loads(loads, engine, 1.0_wp)
    total = 0.5_wp*merge(t, 0.0_wp, [1, 2, 3] <= dim)*norm2(area_vector(dim, f))
    call check(sum(loads%f(:, :loads%n), 2), total, 1.0e-13_wp*norm2(total), "traction times area, half way up the ramp, " &
               //text_of(dim)//"D")
    call check_nodes(engine, loads, total, "traction, "//text_of(dim)//"D")
    call collect_loads(loads, engine, 0.0_wp)
    call check(maxval(abs(loads%f(:, :loads%n))), 0.0_wp, 0.0_wp, "nothing at the foot of the ramp")
  end subroutine test_traction

  !> The same pressure on all faces of one deformed particle adds up to no force and, in the plane, no moment
  subroutine test_closed_surface()
    type(engine_t) :: engine
    type(loads_t) :: loads
    type(cloud_t) :: cloud
    real(wp) :: f(3, 3), moment(3)
    integer :: d, k, q
    do d = 1, 3
      f = some_deformation(d)
      call lattice_cloud(d, [4, 4, 4], [1, 1, 1], 1, spacing, 1.0_wp, cloud)
      cloud%faces = 2.0_wp**(2*d) - 1.0_wp
      do k = 1, 3
        cloud%f(3*k - 2:3*k, 1) = f(k, :)
      end do
      call make_engine(d, basis_ugimp, merge([9, 9, 9], [1, 1, 1], [1, 2, 3] <= d), spacing, cloud, engine, with_faces=.true.)
      call sort_particles(engine)
      if (allocated(loads%load)) deallocate (loads%load)
      allocate (loads%load(1))
      loads%load(1)%kind = load_pressure
      loads%load(1)%pressure = 1.0_wp
      call collect_loads(loads, engine, 0.0_wp)
      call check(loads%n, d*2**d, "two times d faces of 2^(d-1) corners")
      call check(maxval(abs(sum(loads%f(:, :loads%n), 2))), 0.0_wp, 1.0e-15_wp, &
                 "a closed surface feels no net force, "//text_of(d)//"D")
      moment = 0.0_wp
      do q = 1, loads%n
        moment = moment + cross(loads%x(:, q), loads%f(:, q))
      end do
      call check(maxval(abs(moment)), 0.0_wp, 1.0e-14_wp, "nor moment, "//text_of(d)//"D")
    end do
  end subroutine test_closed_surface

  subroutine test_point_force()
    type(engine_t) :: engine
    type(loads_t) :: loads
    real(wp) :: f(3, 3)
    f = some_deformation(2)
    call block_of_particles(2, f, 0, engine)
    allocate (loads%load(1))
    loads%load(1)%kind = load_point
    loads%load(1)%id = 5
    loads%load(1)%vector = [3.0_wp, -4.0_wp, 0.0_wp]
    loads%load(1)%table%times = [0.0_wp, 1.0_wp]
    loads%load(1)%table%factors = [1.0_wp, 3.0_wp]
    call collect_loads(loads, engine, 0.5_wp)
    call check(loads%n, 1, "one point")
    call check(loads%x(:2, 1), [13.5_wp, 13.5_wp] + matmul(f(:2, :2), [0.75_wp, -1.25_wp]), 1.0e-13_wp, &
               "at the particle of that number")
    call check_nodes(engine, loads, [6.0_wp, -8.0_wp, 0.0_wp], "point force")
    loads%load(1)%id = 1000
    call collect_loads(loads, engine, 0.5_wp)
    call check(loads%n, 0, "a particle that is gone carries no force")
  end subroutine test_point_force

  subroutine test_gravity()
    type(loads_t) :: loads
    call check(gravity_at(loads, 1.0_wp), [0.0_wp, 0.0_wp, 0.0_wp], 0.0_wp, "no gravity without a load")
    allocate (loads%gravity(2))
    loads%gravity(1)%acceleration = [0.0_wp, -9.81_wp, 0.0_wp]
    loads%gravity(2)%acceleration = [2.0_wp, 1.0_wp, 0.0_wp]
    loads%gravity(2)%table%ramp_time = 2.0_wp
    call check(gravity_at(loads, 1.0_wp), [1.0_wp, -9.31_wp, 0.0_wp], 1.0e-14_wp, "several add up, each with its ramp")
  end subroutine test_gravity

  !> More points than the first room holds
  subroutine test_many()
    type(engine_t) :: engine
    type(loads_t) :: loads
    type(cloud_t) :: cloud
    call lattice_cloud(3, [2, 2, 2], [6, 6, 6], 2, spacing, 1.0_wp, cloud)
    where (cloud%x(3, :) < 2.3_wp) cloud%faces = 16.0_wp ! z_low
    call make_engine(3, basis_ugimp, [10, 10, 10], spacing, cloud, engine, with_faces=.true.)
    call sort_particles(engine)
    allocate (loads%load(1))
    loads%load(1)%kind = load_pressure
    loads%load(1)%pressure = 2.0_wp
    call collect_loads(loads, engine, 0.0_wp)
    call check(loads%n, 4*144, "four corners of 144 faces")
    call check(sum(loads%f(:, :loads%n), 2), [0.0_wp, 0.0_wp, 2.0_wp*9.0_wp], 1.0e-12_wp, "the bottom is pushed up")
  end subroutine test_many

end program test_loads
