!> Meshes made in memory for tests: structured ones on the box [0, n] x [0, m] (x [0, l]) with cells of edge 1, distorted ones, several kinds.
!>
!> They come as the reader of mesh files would hand them on: elements in the order of kinds, named sides (x_low, x_high, y_low, ..), no
!> connections. Random numbers are our own, so that all compilers make the same mesh.
module gimp_made_meshes
  use gimp_kinds, only: wp, dp, i8
  use gimp_common_kinds, only: pi
  use gimp_error, only: error_t
  use gimp_hdf5, only: hdf5_file_t, open_hdf5, close_hdf5, create_group, write_dataset, write_attribute
  use gimp_mesh, only: mesh_t, n_kinds, kind_name, kind_nodes, kind_corners, kind_sides, side_corners, side_nodes, most_side_corners, &
    line2, triangle3, triangle6, quad4, quad8, quad9, tetrahedron4, hexahedron8
  implicit none(type, external)
  private
  public :: made_lines, made_triangles, made_quads, made_hybrid, made_tetrahedra, made_hexahedra
  public :: made_quadratic, turn_mesh, write_made_mesh, random_t, random_number_of

  !> The state of a generator of random numbers (Park & Miller 1988)
  type :: random_t
    integer(i8) :: state = 4711
  end type random_t

contains

  !> A random number in (0, 1)
  real(dp) function random_number_of(random) result(r)
    type(random_t), intent(inout) :: random
    random%state = modulo(16807_i8*random%state, 2147483647_i8)
    r = real(random%state, dp)/2147483647.0_dp
  end function random_number_of

  !> Lines from 0 to n; inner nodes are moved by up to `distortion` (< 1/2)
  function made_lines(n, distortion) result(mesh)
    integer, intent(in) :: n
    real(dp), intent(in), optional :: distortion
    type(mesh_t) :: mesh
    integer :: i
    call place_nodes([n], mesh)
    call make_elements([(line2, i=1, n)], mesh)
    mesh%node = reshape([(i, i + 1, i=1, n)], [2, n])
    call finish(mesh, [n], distortion)
  end function made_lines

  !> n x m quads; inner nodes are moved in a random direction by up to `distortion` (0.3 keeps all corners convex)
  function made_quads(cells, distortion) result(mesh)
    integer, intent(in) :: cells(2)
    real(dp), intent(in), optional :: distortion
    type(mesh_t) :: mesh
    integer :: e
    call place_nodes(cells, mesh)
    call make_elements([(quad4, e=1, product(cells))], mesh)
    do e = 1, mesh%elements
      mesh%node(:, e) = corners_of_cell(cells, e)
    end do
    call finish(mesh, cells, distortion)
  end function made_quads

  !> n x m cells, each cut into two triangles along diagonals that alternate
  function made_triangles(cells, distortion) result(mesh)
    integer, intent(in) :: cells(2)
    real(dp), intent(in), optional :: distortion
    type(mesh_t) :: mesh
    integer :: c, e
    call place_nodes(cells, mesh)
    call make_elements([(triangle3, e=1, 2*product(cells))], mesh)
    do c = 1, product(cells)
      mesh%node(:, 2*c - 1:2*c) = halves(corners_of_cell(cells, c), modulo(c - 1 + (c - 1)/cells(1), 2) == 0)
    end do
    call finish(mesh, cells, distortion)
  end function made_triangles

  !> n x m cells, a random half of which are cut into two triangles along random diagonals
  function made_hybrid(cells, distortion) result(mesh)
    integer, intent(in) :: cells(2)
    real(dp), intent(in), optional :: distortion
    type(mesh_t) :: mesh
    type(random_t) :: random
    integer, allocatable :: choice(:)
    integer :: c, e, t, q, triangles
    allocate (choice(product(cells)))
    do c = 1, size(choice)
      choice(c) = int(4.0_dp*random_number_of(random)) ! 0, 1: a quad; 2, 3: triangles
    end do
    triangles = 2*count(choice >= 2)
    call place_nodes(cells, mesh)
    call make_elements([(triangle3, e=1, triangles), (quad4, e=1, count(choice < 2))], mesh)
    t = 0
    q = triangles
    do c = 1, size(choice)
      if (choice(c) < 2) then
        q = q + 1
        mesh%node(:, q) = corners_of_cell(cells, c)
      else
        mesh%node(:3, t + 1:t + 2) = halves(corners_of_cell(cells, c), choice(c) == 2)
        t = t + 2
      end if
    end do
    call finish(mesh, cells, distortion)
  end function made_hybrid

  !> n x m x l cubes, each cut into six tetrahedra around its diagonal, faces matching
  function made_tetrahedra(cells, distortion) result(mesh)
    integer, intent(in) :: cells(3)
    real(dp), intent(in), optional :: distortion
    type(mesh_t) :: mesh
    integer, parameter :: six(4, 6) = reshape([1, 2, 3, 7, 1, 3, 4, 7, 1, 4, 8, 7, 1, 8, 5, 7, 1, 5, 6, 7, 1, 6, 2, 7], [4, 6])
    integer :: c, e, k, corner(8)
    call place_nodes(cells, mesh)
    call make_elements([(tetrahedron4, e=1, 6*product(cells))], mesh)
    do c = 1, product(cells)
      corner = corners_of_cell(cells, c)
      do k = 1, 6
        mesh%node(:, 6*(c - 1) + k) = corner(six(:, k))
      end do
    end do
    call finish(mesh, cells, distortion)
  end function made_tetrahedra

  !> n x m x l hexahedra; distorted ones have faces that are not flat
  function made_hexahedra(cells, distortion) result(mesh)
    integer, intent(in) :: cells(3)
    real(dp), intent(in), optional :: distortion
    type(mesh_t) :: mesh
    integer :: e
    call place_nodes(cells, mesh)
    call make_elements([(hexahedron8, e=1, product(cells))], mesh)
    do e = 1, mesh%elements
      mesh%node(:, e) = corners_of_cell(cells, e)
    end do
    call finish(mesh, cells, distortion)
  end function made_hexahedra

  !> A mesh of triangles and quads with nodes at the middles of sides (and in the centres of quads: quad9 instead of quad8). The middles are
  !> moved along the normal of their side by up to `bulge` of its length, those of the boundary too
  function made_quadratic(linear, centres, bulge) result(mesh)
    type(mesh_t), intent(in) :: linear
    logical, intent(in) :: centres
    real(dp), intent(in), optional :: bulge
    type(mesh_t) :: mesh
    integer, allocatable :: first(:), next(:), other_end(:), middle(:)
    real(wp), allocatable :: x(:, :)
    type(random_t) :: random
    integer :: e, s, k, n, edges, corner(most_side_corners)
    real(wp) :: along(2)
    mesh = linear
    where (linear%kind == triangle3)
      mesh%kind = triangle6
    elsewhere
      mesh%kind = merge(quad9, quad8, centres)
    end where
    deallocate (mesh%node)
    allocate (mesh%node(maxval(kind_nodes(mesh%kind)), mesh%elements), source=0)
    allocate (x(2, linear%nodes + 5*mesh%elements), source=0.0_wp)
    allocate (first(linear%nodes), source=0)
    allocate (next(4*mesh%elements), other_end(4*mesh%elements), middle(4*mesh%elements))
    x(:, :linear%nodes) = linear%x
    n = linear%nodes
    edges = 0
    do e = 1, mesh%elements
      mesh%node(:kind_corners(mesh%kind(e)), e) = linear%node(:kind_corners(mesh%kind(e)), e)
      do s = 1, kind_sides(mesh%kind(e))
        corner = side_nodes(mesh, e, s)
        k = first(minval(corner(:2))) ! edges are listed under the lower of their nodes
        do while (k > 0)
          if (other_end(k) == maxval(corner(:2))) exit
          k = next(k)
        end do
        if (k == 0) then
          n = n + 1
          along = linear%x(:, corner(2)) - linear%x(:, corner(1))
          x(:, n) = linear%x(:, corner(1)) + 0.5_wp*along
          if (present(bulge)) x(:, n) = x(:, n) + real(bulge*(2.0_dp*random_number_of(random) - 1.0_dp), wp)*[-along(2), along(1)]
          edges = edges + 1
          k = edges
          next(k) = first(minval(corner(:2)))
          first(minval(corner(:2))) = k
          other_end(k) = maxval(corner(:2))
          middle(k) = n
        end if
        mesh%node(kind_corners(mesh%kind(e)) + s, e) = middle(k)
      end do
      if (mesh%kind(e) == quad9) then
        n = n + 1
        x(:, n) = 0.5_wp*sum(x(:, mesh%node(5:8, e)), 2) - 0.25_wp*sum(x(:, mesh%node(1:4, e)), 2) ! as a quad8 has it there
        mesh%node(9, e) = n
      end if
    end do
    mesh%nodes = n
    mesh%x = x(:, :n)
    mesh%node_in_file = [(k, k=1, n)]
  end function made_quadratic

  !> Turn a mesh about the z axis through the origin
  subroutine turn_mesh(mesh, degrees)
    type(mesh_t), intent(inout) :: mesh
    real(dp), intent(in) :: degrees
    real(wp) :: c, s
    integer :: i
    c = real(cos(degrees*pi/180.0_dp), wp)
    s = real(sin(degrees*pi/180.0_dp), wp)
    do i = 1, mesh%nodes
      mesh%x(:2, i) = [c*mesh%x(1, i) - s*mesh%x(2, i), s*mesh%x(1, i) + c*mesh%x(2, i)]
    end do
  end subroutine turn_mesh

  !> Write a mesh file; elements must stand in the order of kinds
  subroutine write_made_mesh(path, mesh, lower, spacing)
    character(len=*), intent(in) :: path
    type(mesh_t), intent(in) :: mesh
    real(dp), intent(in) :: lower(:), spacing !! [m]
    type(hdf5_file_t) :: file
    type(error_t), allocatable :: error
    real(dp) :: x(mesh%dim, mesh%nodes)
    integer :: d, kind, first, last
    do d = 1, mesh%dim
      x(d, :) = lower(d) + spacing*mesh%x(d, :)
    end do
    call open_hdf5(path, "overwrite", file, error)
    if (allocated(error)) error stop "write_made_mesh"
    call write_attribute(file, "", "format", "gimp-mesh", error)
    call write_attribute(file, "", "version", 1, error)
    call write_attribute(file, "", "dimension", mesh%dim, error)
    call write_dataset(file, "nodes", x, error)
    call create_group(file, "elements", error)
    do kind = 1, n_kinds
      first = findloc(mesh%kind, kind, dim=1)
      if (first == 0) cycle
      last = findloc(mesh%kind, kind, dim=1, back=.true.)
      call write_dataset(file, "elements/"//trim(kind_name(kind)), mesh%node(:kind_nodes(kind), first:last), error)
      if (allocated(mesh%element_group)) &
        call write_dataset(file, "elements/"//trim(kind_name(kind))//"_group", mesh%element_group(first:last), error)
    end do
    if (allocated(mesh%element_group_name)) &
      call write_attribute(file, "", "element_groups", joined(mesh%element_group_name), error)
    call write_attribute(file, "", "side_groups", joined(mesh%side_group_name), error)
    call create_group(file, "sides", error)
    call write_dataset(file, "sides/nodes", mesh%named_side_node, error)
    call write_dataset(file, "sides/group", mesh%named_side_group, error)
    call close_hdf5(file, error)
  end subroutine write_made_mesh

  !> Names with new lines between them
  pure function joined(names) result(text)
    character(len=*), intent(in) :: names(:)
    character(len=:), allocatable :: text
    integer :: k
    text = ""
    do k = 1, size(names)
      if (k > 1) text = text//new_line("a")
      text = text//trim(names(k))
    end do
  end function joined

  !> Nodes at whole numbers, along x first
  subroutine place_nodes(cells, mesh)
    integer, intent(in) :: cells(:)
    type(mesh_t), intent(out) :: mesh
    integer :: i, d, rest
    mesh%dim = size(cells)
    mesh%nodes = product(cells + 1)
    allocate (mesh%x(mesh%dim, mesh%nodes))
    do i = 1, mesh%nodes
      rest = i - 1
      do d = 1, mesh%dim
        mesh%x(d, i) = modulo(rest, cells(d) + 1)
        rest = rest/(cells(d) + 1)
      end do
    end do
    mesh%node_in_file = [(i, i=1, mesh%nodes)]
  end subroutine place_nodes

  !> Room for elements, numbered within their kind
  subroutine make_elements(kinds, mesh)
    integer, intent(in) :: kinds(:)
    type(mesh_t), intent(inout) :: mesh
    integer :: e
    mesh%elements = size(kinds)
    mesh%kind = kinds
    allocate (mesh%node(maxval(kind_nodes(kinds)), mesh%elements), mesh%element_in_file(mesh%elements), source=0)
    mesh%element_in_file(:1) = 1
    do e = 2, mesh%elements
      mesh%element_in_file(e) = 1
      if (kinds(e) == kinds(e - 1)) mesh%element_in_file(e) = mesh%element_in_file(e - 1) + 1
    end do
  end subroutine make_elements

  !> The corners of a cell of the box in the order of quads and hexahedra
  pure function corners_of_cell(cells, c) result(node)
    integer, intent(in) :: cells(:), c
    integer :: node(2**size(cells))
    integer :: low(3), step(3), d
    low = 0
    low(:2) = [modulo(c - 1, cells(1)), (c - 1)/cells(1)]
    if (size(cells) == 3) low(2:3) = [modulo(low(2), cells(2)), low(2)/cells(2)]
    step = [1, cells(1) + 1, (cells(1) + 1)*(cells(2) + 1)]
    d = 1 + dot_product(low, step)
    node(:4) = d + [0, step(1), step(1) + step(2), step(2)]
    if (size(cells) == 3) node(5:) = node(:4) + step(3)
  end function corners_of_cell

  !> The two triangles of a quad
  pure function halves(q, rising) result(node)
    integer, intent(in) :: q(4)
    logical, intent(in) :: rising !! cut from its first corner to its third
    integer :: node(3, 2)
    if (rising) then
      node = reshape([q(1), q(2), q(3), q(1), q(3), q(4)], [3, 2])
    else
      node = reshape([q(1), q(2), q(4), q(2), q(3), q(4)], [3, 2])
    end if
  end function halves

  !> Name the sides of the box, then move inner nodes
  subroutine finish(mesh, cells, distortion)
    type(mesh_t), intent(inout) :: mesh
    integer, intent(in) :: cells(:)
    real(dp), intent(in), optional :: distortion
    type(random_t) :: random
    real(dp) :: step(3)
    integer :: i, d
    call name_sides(mesh, cells)
    if (.not. present(distortion)) return
    do i = 1, mesh%nodes
      if (any(mesh%x(:, i) <= 0.0_wp .or. mesh%x(:, i) >= cells)) cycle
      do ! a random point of the ball
        do d = 1, 3
          step(d) = 2.0_dp*random_number_of(random) - 1.0_dp
        end do
        if (sum(step(:mesh%dim)**2) <= 1.0_dp) exit
      end do
      mesh%x(:, i) = mesh%x(:, i) + real(distortion*step(:mesh%dim), wp)
    end do
  end subroutine finish

  !> Groups x_low, x_high, y_low, .. of the sides of the box
  subroutine name_sides(mesh, cells)
    type(mesh_t), intent(inout) :: mesh
    integer, intent(in) :: cells(:)
    character(len=*), parameter :: names(6) = [character(len=6) :: "x_low", "x_high", "y_low", "y_high", "z_low", "z_high"]
    integer :: pass, e, s, d, n, k, corner(most_side_corners), corners
    mesh%side_group_name = names(:2*mesh%dim)
    do pass = 1, 2 ! count, then fill
      n = 0
      do e = 1, mesh%elements
        corners = side_corners(mesh%kind(e))
        do s = 1, kind_sides(mesh%kind(e))
          corner = side_nodes(mesh, e, s)
          do d = 1, mesh%dim
            k = 0
            if (all(mesh%x(d, corner(:corners)) <= 0.0_wp)) k = 2*d - 1
            if (all(mesh%x(d, corner(:corners)) >= cells(d))) k = 2*d
            if (k == 0) cycle
            n = n + 1
            if (pass == 1) cycle
            mesh%named_side_node(:, n) = corner
            mesh%named_side_group(n) = k
          end do
        end do
      end do
      if (pass == 1) allocate (mesh%named_side_node(most_side_corners, n), mesh%named_side_group(n))
    end do
  end subroutine name_sides

end module gimp_made_meshes
