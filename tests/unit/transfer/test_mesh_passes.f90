!> Passes on meshes: a Cartesian grid written as a mesh gives what the grid gives, for every basis that works on both
program test_mesh_passes
  use gimp_kinds, only: wp, dp, lanes
  use gimp_grid, only: nf => fields_per_node, nodes_per_block, node_at_place
  use gimp_basis, only: basis_linear, basis_cpdi, basis_cpdi2, basis_ddmp, basis_gauss, is_sampled
  use gimp_domains, only: domain_edges, domain_carried
  use gimp_point_domains, only: point_rule_t, corner_rule, volume_rule, surface_rule, simpson_rule
  use gimp_corner_domains, only: carried_box
  use gimp_engine, only: engine_t, pass_t, affine_none, affine_apic, affine_tpic, sum_left, fate_fine
  use gimp_mesh, only: mesh_t
  use gimp_made_meshes, only: made_lines, made_quads, made_hexahedra
  use gimp_particle_pass, only: particle_pass
  use gimp_resort, only: sort_particles
  use gimp_engine_fixture, only: cloud_t, random_cloud, make_engine, read_cloud, node_sums
  use gimp_text, only: text_of
  use gimp_check, only: begin_suite, end_suite, check, check_true
  implicit none(type, external)

  real(wp), parameter :: spacing = 0.5_wp
  !> Sums of some 50 shares; positions of up to 30 cells know their place in a cell to 30 epsilon, which slopes show
  real(wp), parameter :: tolerance = 2.0e-13_wp
  integer :: seed = 11, dim

  call begin_suite("passes on meshes")
  do dim = 1, 3
    call test_like_grid(dim, basis_linear, affine_none)
    call test_like_grid(dim, basis_ddmp, affine_none)
    call test_like_grid(dim, basis_cpdi, affine_none, corner_rule(dim))
    call test_like_grid(dim, basis_cpdi, affine_apic, corner_rule(dim))
    call test_like_grid(dim, basis_cpdi, affine_tpic, corner_rule(dim))
    call test_like_grid(dim, basis_gauss, affine_none, volume_rule(dim, 2))
    call test_like_grid(dim, basis_gauss, affine_none, surface_rule(dim, 2))
    call test_like_grid(dim, basis_gauss, affine_apic, simpson_rule(dim))
    call test_like_grid(dim, basis_cpdi2, affine_none, point_rule_t(n=2**dim, carried=carried_box))
    call test_like_grid(dim, basis_cpdi2, affine_apic, point_rule_t(n=2**dim, carried=carried_box))
  end do
  call end_suite()

contains

  function cells_of(dim) result(cells)
    integer, intent(in) :: dim
    integer :: cells(3)
    cells = 1
    cells(:dim) = merge(200, merge(30, 12, dim == 2), dim == 1)
  end function cells_of

  function mesh_of(dim) result(mesh)
    integer, intent(in) :: dim
    type(mesh_t) :: mesh
    integer :: cells(3)
    cells = cells_of(dim)
    select case (dim)
    case (1); mesh = made_lines(cells(1), 0.0_dp)
    case (2); mesh = made_quads(cells(:2), 0.0_dp)
    case default; mesh = made_hexahedra(cells, 0.0_dp)
    end select
  end function mesh_of

  !> Give, take from a velocity field of the nodes, move and give again, on the grid and on the mesh
  subroutine test_like_grid(dim, basis, affine, rule)
    integer, intent(in) :: dim, basis, affine
    type(point_rule_t), intent(in), optional :: rule
    type(engine_t) :: on_grid, on_mesh
    type(cloud_t) :: cloud, grid_cloud, mesh_cloud
    character(len=:), allocatable :: what
    real(wp) :: low(3), high(3)
    what = text_of(dim)//"D basis "//text_of(basis)//" affine "//text_of(affine)
    low = 0.0_wp
    low(:dim) = 3.0_wp
    high = cells_of(dim) - 3.0_wp
    if (basis == basis_ddmp) then ! its smeared gradients know the ends of the box
      low(:dim) = 0.1_wp
      high = cells_of(dim) - 0.1_wp
    end if
    call random_cloud(dim, 400, low, high, 0.1_wp, 0.4_wp, seed, cloud)
    if (basis /= basis_linear) cloud%x(1:dim, 5) = anint(cloud%x(1:dim, 5)) ! on a node, where tents have no slope
    call make_engine(dim, basis, cells_of(dim), spacing, cloud, on_grid, with_force=.true., affine=affine, rule=rule)
    call make_engine(dim, basis, cells_of(dim), spacing, cloud, on_mesh, with_force=.true., affine=affine, rule=rule, mesh=mesh_of(dim))
    call prepare(on_grid)
    call prepare(on_mesh)
    call run(on_grid, pass_t(momentum=.true., force=.true.))
    call run(on_mesh, pass_t(momentum=.true., force=.true.))
    call compare_nodes(on_grid, on_mesh, "given at first: "//what)
    call set_nodes(on_grid)
    call set_nodes(on_mesh)
    call run(on_grid, step())
    call run(on_mesh, step())
    call check_true(all(on_mesh%fate(1, :) == fate_fine), "nobody is lost: "//what)
    call read_cloud(on_grid, grid_cloud)
    call read_cloud(on_mesh, mesh_cloud)
    call check(maxval(abs(grid_cloud%x - mesh_cloud%x)), 0.0_wp, atol=tolerance, what="positions: "//what)
    call check(maxval(abs(grid_cloud%v - mesh_cloud%v)), 0.0_wp, atol=tolerance, what="velocities: "//what)
    call check(maxval(abs(grid_cloud%f - mesh_cloud%f)), 0.0_wp, atol=10*tolerance, what="deformation: "//what)
    call compare_nodes(on_grid, on_mesh, "given after a step: "//what)
    call check_true(on_mesh%all_sums(sum_left) > 0.0_dp, "some particles leave their elements: "//what)
  end subroutine test_like_grid

  subroutine prepare(engine)
    type(engine_t), intent(inout) :: engine
    if (is_sampled(engine%basis)) engine%domain_rule = domain_edges
    if (engine%basis == basis_cpdi2) engine%domain_rule = domain_carried
    engine%domain_volume = engine%basis == basis_cpdi2
    call sort_particles(engine)
  end subroutine prepare

  subroutine run(engine, pass)
    type(engine_t), intent(inout) :: engine
    type(pass_t), intent(in) :: pass
    call particle_pass(engine, pass)
  end subroutine run

  !> The pass of a step that moves some particles out of their elements
  pure type(pass_t) function step()
    step = pass_t(velocity=.true., position=.true., strain=.true., momentum=.true., force=.true., dt=0.2_wp, dt_strain=0.2_wp, &
                  kick=0.1_wp, flip=0.9_wp)
  end function step

  !> Velocities that bend within cells, and their change
  subroutine set_nodes(engine)
    type(engine_t), intent(inout) :: engine
    real(wp) :: x(3)
    integer :: s, i, k
    do s = 1, engine%table%slots
      do i = 1, nodes_per_block
        x = node_at(engine, s, i)
        engine%g(:, i, s) = 0.0_wp
        do k = 1, engine%grid%dim
          engine%g(k, i, s) = 0.3_wp*sin(0.7_wp*x(1) + 0.4_wp*x(2) - 0.3_wp*x(3) + k)
          engine%g(4 + k, i, s) = 0.1_wp*cos(0.2_wp*x(1) - 0.6_wp*x(2) + 0.5_wp*x(3) + k)
        end do
      end do
    end do
  end subroutine set_nodes

  !> Place of a node [cells]; far off where the last slot has none
  function node_at(engine, s, i) result(x)
    type(engine_t), intent(in) :: engine
    integer, intent(in) :: s, i
    real(wp) :: x(3)
    integer :: node(3)
    node = node_at_place(engine%grid, engine%table%slot_at(:, s), i)
    x = node
    if (.not. engine%grid%is_mesh) return
    x = 0.0_wp
    x(1) = -1000.0_wp
    if (node(1) <= engine%mesh%nodes) x(:engine%grid%dim) = engine%mesh%x(:, node(1))
  end function node_at

  !> What nodes at the same place were given
  subroutine compare_nodes(on_grid, on_mesh, what)
    type(engine_t), intent(in) :: on_grid, on_mesh
    character(len=*), intent(in) :: what
    real(wp), allocatable :: raw(:, :, :), box(:, :, :, :), here(:, :, :, :)
    integer :: cells(3), f
    cells = cells_of(on_grid%grid%dim)
    cells(on_grid%grid%dim + 1:) = 0
    allocate (box(nf, 0:cells(1), 0:cells(2), 0:cells(3)), here(nf, 0:cells(1), 0:cells(2), 0:cells(3)), source=0.0_wp)
    call node_sums(on_grid, raw)
    call fill(on_grid, raw, box)
    call node_sums(on_mesh, raw)
    call fill(on_mesh, raw, here)
    do f = 1, nf
      if (maxval(abs(box(f, :, :, :))) > 0.0_wp) call check(maxval(abs(box(f, :, :, :) - here(f, :, :, :)))/maxval(abs(box(f, :, :, :))), 0.0_wp, &
        atol=tolerance, what=what//", field "//text_of(f))
    end do
  end subroutine compare_nodes

  subroutine fill(engine, raw, box)
    type(engine_t), intent(in) :: engine
    real(wp), intent(in) :: raw(:, :, :)
    real(wp), intent(inout) :: box(:, 0:, 0:, 0:)
    integer :: s, i, at(3)
    do s = 1, engine%table%slots
      do i = 1, nodes_per_block
        at = nint(node_at(engine, s, i))
        if (any(at < 0) .or. any(at >= [size(box, 2), size(box, 3), size(box, 4)])) cycle
        box(:, at(1), at(2), at(3)) = raw(:, i, s)
      end do
    end do
  end subroutine fill

end program test_mesh_passes
