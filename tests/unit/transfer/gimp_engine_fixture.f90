!> Engines made without a scene: a cloud of particles as plain tables, and the grid around it
module gimp_engine_fixture
  use gimp_kinds, only: wp, dp, i8, lanes
  use gimp_grid, only: make_grid, nodes_per_block, fields_per_node
  use gimp_particles, only: add_field, allot_chunks, clear_chunks, group_t
  use gimp_basis, only: basis_linear, basis_cpgimp, is_sampled
  use gimp_point_domains, only: point_rule_t, corner_rule
  use gimp_corner_domains, only: carried_none, carried_box
  use gimp_engine, only: engine_t, anti_f_bar, anti_b_bar, leaving_stops
  use gimp_mesh, only: mesh_t
  use gimp_patches, only: make_patches
  use gimp_mesh_connect, only: connect_mesh
  use gimp_search, only: found_t, make_locator, find_anywhere
  use gimp_mesh_pads, only: prepare_mesh
  use gimp_neo_hookean, only: neo_hookean_t
  use gimp_pads, only: sum_pads, add_spills
  implicit none(type, external)
  private
  public :: cloud_t, make_cloud, random_cloud, lattice_cloud, make_engine, read_cloud, node_sums, random_reals, identity9

  real(wp), parameter :: identity9(9) = [1.0_wp, 0.0_wp, 0.0_wp, 0.0_wp, 1.0_wp, 0.0_wp, 0.0_wp, 0.0_wp, 1.0_wp]

  !> Particles as plain tables
  type :: cloud_t
    integer :: n = 0
    real(wp), allocatable :: x(:, :) !! (3, n) position [cells from the corner of the box]
    real(wp), allocatable :: v(:, :) !! (3, n) [m/s]
    real(wp), allocatable :: f(:, :) !! (9, n) deformation gradient, full
    real(wp), allocatable :: half0(:, :) !! (3, n) initial half lengths [cells]
    real(wp), allocatable :: half(:, :) !! (3, n) present half lengths [cells], cpgimp
    real(wp), allocatable :: mass(:), volume(:) !! (n) [kg], [m3]
    real(wp), allocatable :: force(:, :) !! (3, n) [N]
    real(wp), allocatable :: faces(:) !! (n) loaded faces
    integer, allocatable :: material(:) !! (n)
    integer(i8), allocatable :: id(:) !! (n)
  end type cloud_t

contains

  !> Reproducible numbers in (-1, 1): the same on every machine
  subroutine random_reals(seed, x)
    integer, intent(inout) :: seed
    real(wp), intent(out) :: x(:)
    integer :: k
    do k = 1, size(x)
      seed = modulo(16807*modulo(seed, 127773) - 2836*(seed/127773), 2147483647)
      x(k) = 2*(seed/2147483647.0_wp) - 1
    end do
  end subroutine random_reals

  !> Room for n particles at rest and undeformed
  subroutine make_cloud(n, cloud)
    integer, intent(in) :: n
    type(cloud_t), intent(out) :: cloud
    integer :: i
    cloud%n = n
    allocate (cloud%x(3, n), cloud%v(3, n), cloud%force(3, n), cloud%mass(n), cloud%volume(n), cloud%faces(n), source=0.0_wp)
    allocate (cloud%half(3, n), cloud%half0(3, n), source=0.25_wp)
    allocate (cloud%material(n), source=1)
    allocate (cloud%f(9, n), source=spread(identity9, 2, n))
    allocate (cloud%id(n), source=[(int(i, i8), i=1, n)])
  end subroutine make_cloud

  !> Particles anywhere between two corners [cells], with random velocities, masses, volumes, forces and deformations near
  !> the identity; half lengths between the two given ones [cells]
  subroutine random_cloud(dim, n, low, high, short, long, seed, cloud)
    integer, intent(in) :: dim, n
    real(wp), intent(in) :: low(3), high(3), short, long
    integer, intent(inout) :: seed
    type(cloud_t), intent(out) :: cloud
    real(wp) :: u(24)
    integer :: i, k
    call make_cloud(n, cloud)
    do i = 1, n
      call random_reals(seed, u)
      do k = 1, dim
        cloud%x(k, i) = low(k) + 0.5_wp*(u(k) + 1.0_wp)*(high(k) - low(k))
        cloud%v(k, i) = u(3 + k)
        cloud%half(k, i) = short + 0.5_wp*(u(6 + k) + 1.0_wp)*(long - short)
        cloud%force(k, i) = u(9 + k)
        cloud%f(3*(k - 1) + 1:3*(k - 1) + dim, i) = cloud%f(3*(k - 1) + 1:3*(k - 1) + dim, i) &
                                                   + 0.1_wp*u(12 + 3*(k - 1) + 1:12 + 3*(k - 1) + dim)
      end do
      cloud%half0(:, i) = cloud%half(:, i)
      cloud%mass(i) = 1.5_wp + u(22)
      cloud%volume(i) = 1.5_wp + u(23)
    end do
  end subroutine random_cloud

  !> A block of particles, `per_axis` in each cell and direction, filling `cells` cells from the cell `low`
  subroutine lattice_cloud(dim, low, cells, per_axis, spacing, density, cloud)
    integer, intent(in) :: dim, low(3), cells(3), per_axis
    real(wp), intent(in) :: spacing, density !! [m], [kg/m3]
    type(cloud_t), intent(out) :: cloud
    integer :: count(3), i, j, k, n
    count = 1
    count(:dim) = cells(:dim)*per_axis
    call make_cloud(product(count), cloud)
    n = 0
    do k = 1, count(3)
      do j = 1, count(2)
        do i = 1, count(1)
          n = n + 1
          cloud%x(:dim, n) = low(:dim) + (real([i, j, k], wp) - 0.5_wp)/per_axis*merge(1.0_wp, 0.0_wp, [1, 2, 3] <= dim)
        end do
      end do
    end do
    cloud%half = 0.5_wp/per_axis
    cloud%half0 = cloud%half
    cloud%volume = (spacing/per_axis)**dim
    cloud%mass = density*cloud%volume
  end subroutine lattice_cloud

  !> An engine with these particles, neo-Hookean materials of different stiffness; particles still have to be sorted
  subroutine make_engine(dim, basis, cells, spacing, cloud, engine, with_force, with_faces, uniform, affine, rule, anti_locking, &
                         acceleration, mesh)
    integer, intent(in) :: dim, basis
    type(mesh_t), intent(in), optional :: mesh !! in place of the cells of the grid, not yet connected
    integer, intent(in) :: cells(3)
    real(wp), intent(in) :: spacing !! [m]
    type(cloud_t), intent(in) :: cloud
    type(engine_t), intent(out) :: engine
    logical, intent(in), optional :: with_force, with_faces
    logical, intent(in), optional :: uniform !! half lengths of the first particle for all, not stored with each
    logical, intent(in), optional :: acceleration !! particles keep theirs
    integer, intent(in), optional :: affine !! kind of affine transfer; the gradients carried start at zero
    type(point_rule_t), intent(in), optional :: rule !! points at which domains are sampled; corners if absent
    integer, intent(in), optional :: anti_locking !! with the gradient that laws see, which starts as F
    real(dp) :: zero(3)
    integer :: m, i, k, c, l, chunks, of_material
    logical :: stores_half
    zero = 0.0_dp
    engine%grid = make_grid(dim, zero, cells*real(spacing, dp), real(spacing, dp))
    engine%basis = basis
    allocate (engine%laws(maxval(cloud%material)))
    do m = 1, size(engine%laws)
      allocate (engine%laws(m)%law, source=neo_hookean_t(density=1000.0_wp, lambda=600.0_wp*m, mu=400.0_wp*m))
    end do
    stores_half = .true.
    if (present(uniform)) stores_half = .not. uniform
    associate (p => engine%particles)
      p%dim = dim
      call add_field(p, "position", dim, p%position)
      call add_field(p, "velocity", dim, p%velocity)
      call add_field(p, "deformation", dim*dim, p%deformation)
      call add_field(p, "mass", 1, p%mass)
      call add_field(p, "volume", 1, p%volume)
      if (stores_half) then
        call add_field(p, "half_length", dim, p%half_length)
      else
        p%uniform_half = cloud%half0(:, 1)
      end if
      if (basis == basis_cpgimp) call add_field(p, "domain", dim, p%domain)
      if (is_sampled(basis)) then
        call add_field(p, "domain", dim*dim, p%domain)
        engine%rule = corner_rule(dim)
        if (present(rule)) engine%rule = rule
        if (engine%rule%carried /= carried_none) then
          call add_field(p, "corner", dim*engine%rule%n, p%corner)
          call add_field(p, "detached", 1, p%detached)
        end if
      end if
      if (present(with_force)) then
        if (with_force) call add_field(p, "force", dim, p%force)
      end if
      if (present(with_faces)) then
        if (with_faces) call add_field(p, "faces", 1, p%faces)
      end if
      if (present(affine)) then
        engine%affine = affine
        call add_field(p, "affine", dim*dim, p%affine)
      end if
      if (present(anti_locking)) engine%anti_locking = anti_locking
      if (engine%anti_locking == anti_f_bar .or. engine%anti_locking == anti_b_bar) call add_field(p, "evened_deformation", dim*dim, p%evened)
      if (present(acceleration)) then
        if (acceleration) call add_field(p, "acceleration", dim, p%acceleration)
      end if
      call add_field(p, "reference", dim, p%reference)
      if (present(mesh)) call add_field(p, "element", 1, p%element)
      if (present(mesh) .and. is_sampled(basis)) call add_field(p, "point_element", (engine%rule%n + 1)/2, p%point_element)
      allocate (p%groups(size(engine%laws)))
      chunks = 0
      do m = 1, size(engine%laws)
        of_material = count(cloud%material == m)
        p%groups(m) = group_t(0, m, chunks + 1, chunks + (of_material + lanes - 1)/lanes)
        chunks = p%groups(m)%last
      end do
      call allot_chunks(p, chunks)
      call clear_chunks(p)
      do m = 1, size(engine%laws)
        c = p%groups(m)%first
        l = 0
        do i = 1, cloud%n
          if (cloud%material(i) /= m) cycle
          l = l + 1
          if (l > lanes) then
            l = 1
            c = c + 1
          end if
          p%id(l, c) = cloud%id(i)
          call set_field(p%position%first, cloud%x(:dim, i))
          call set_field(p%reference%first, cloud%x(:dim, i))
          call set_field(p%velocity%first, cloud%v(:dim, i))
          call set_field(p%deformation%first, [(cloud%f(3*(k - 1) + 1:3*(k - 1) + dim, i), k=1, dim)])
          if (p%evened%first > 0) call set_field(p%evened%first, [(cloud%f(3*(k - 1) + 1:3*(k - 1) + dim, i), k=1, dim)])
          call set_field(p%mass%first, [cloud%mass(i)])
          call set_field(p%volume%first, [cloud%volume(i)])
          if (p%half_length%first > 0) call set_field(p%half_length%first, cloud%half0(:dim, i))
          if (basis == basis_cpgimp) call set_field(p%domain%first, cloud%half(:dim, i))
          if (is_sampled(basis)) call set_field(p%domain%first, [(cloud%f(k:3*dim:3, i)*cloud%half0(k, i), k=1, dim)])
          if (p%corner%first > 0) call set_field(p%corner%first, distorted_domain(i))
          if (p%force%first > 0) call set_field(p%force%first, cloud%force(:dim, i))
          if (p%faces%first > 0) call set_field(p%faces%first, [cloud%faces(i)])
        end do
      end do
    end associate
    if (present(mesh)) call put_on_mesh(engine, mesh)

  contains

    !> Corners of the domain F half0 around a particle, each pushed aside by up to a fifth of the half lengths
    function distorted_domain(i) result(corner)
      integer, intent(in) :: i
      real(wp), allocatable :: corner(:)
      real(wp) :: place(3), noise(3)
      integer :: a, q, seed
      allocate (corner(dim*engine%rule%n))
      seed = 1 + i
      do a = 1, engine%rule%n
        if (engine%rule%carried == carried_box) then
          place = [(merge(1.0_wp, -1.0_wp, btest(a - 1, q - 1)), q=1, 3)]
        else
          place = merge(1.5_wp, -0.5_wp, [(q == a - 1, q=1, 3)])
        end if
        do q = 1, 3
          call random_reals(seed, noise)
        end do
        place = (place + 0.2_wp*noise)*cloud%half0(:, i)
        do q = 1, dim
          corner(dim*(a - 1) + q) = cloud%x(q, i) + dot_product(cloud%f(3*(q - 1) + 1:3*(q - 1) + dim, i), place(:dim))
        end do
      end do
    end function distorted_domain

    subroutine set_field(first, values)
      integer, intent(in) :: first
      real(wp), intent(in) :: values(:)
      engine%particles%p(l, first:first + size(values) - 1, c) = values
    end subroutine set_field

  end subroutine make_engine

  !> A mesh in place of the grid: its patches, and the elements of the particles, which may stand anywhere in it
  subroutine put_on_mesh(engine, mesh)
    type(engine_t), intent(inout) :: engine
    type(mesh_t), intent(in) :: mesh
    type(found_t) :: found
    integer :: c, l
    engine%mesh = mesh
    engine%grid%is_mesh = .true.
    engine%grid%edge = 0
    call make_patches(engine%mesh, engine%patches)
    call connect_mesh(engine%mesh)
    call make_locator(engine%mesh, engine%locator)
    call prepare_mesh(engine)
    allocate (engine%leaving(size(engine%mesh%side_element)), source=leaving_stops)
    associate (p => engine%particles)
      do c = 1, p%chunks
        do l = 1, lanes
          call find_anywhere(engine%mesh, engine%locator, p%p(l, :engine%grid%dim, c), found)
          p%p(l, p%element%first, c) = max(1, found%element)
        end do
      end do
    end associate
  end subroutine put_on_mesh

  !> The particles of an engine as tables in the order of their numbers, which must be 1 to n; positions absolute [cells]
  subroutine read_cloud(engine, cloud)
    type(engine_t), intent(in) :: engine
    type(cloud_t), intent(out) :: cloud
    integer :: g, c, l, k, i, d
    call make_cloud(int(engine%particles%n), cloud)
    cloud%id = 0
    d = engine%grid%dim
    associate (p => engine%particles)
      do g = 1, size(p%groups)
        do c = p%groups(g)%first, p%groups(g)%last
          do l = 1, lanes
            if (p%id(l, c) == 0) cycle
            i = int(p%id(l, c))
            cloud%id(i) = i
            cloud%material(i) = p%groups(g)%material
            cloud%x(:d, i) = p%p(l, p%position%first:p%position%first + d - 1, c) + p%groups(g)%at(:d)*engine%grid%edge(:d)
            cloud%v(:d, i) = p%p(l, p%velocity%first:p%velocity%first + d - 1, c)
            do k = 1, d
              cloud%f(3*(k - 1) + 1:3*(k - 1) + d, i) = &
                p%p(l, p%deformation%first + d*(k - 1):p%deformation%first + d*k - 1, c)
            end do
            if (p%domain%first > 0) cloud%half(:d, i) = p%p(l, p%domain%first:p%domain%first + d - 1, c)
            cloud%mass(i) = p%p(l, p%mass%first, c)
            cloud%volume(i) = p%p(l, p%volume%first, c)
          end do
        end do
      end do
    end associate
  end subroutine read_cloud

  !> What the particles gave to the nodes in the last pass, pads and spills, without images
  subroutine node_sums(engine, raw)
    type(engine_t), intent(in) :: engine
    real(wp), allocatable, intent(out) :: raw(:, :, :) !! (field, node of block, slot)
    integer :: s
    allocate (raw(fields_per_node, nodes_per_block, engine%table%slots))
    do s = 1, engine%table%slots
      call sum_pads(engine, s, raw(:, :, s))
    end do
    call add_spills(engine, engine%table%slots, raw)
  end subroutine node_sums

end module gimp_engine_fixture
