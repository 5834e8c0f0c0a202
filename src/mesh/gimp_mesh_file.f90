!> Mesh files: HDF5, written by the scripts in preprocessing/ (docs/mesh-format.md). Every rank reads the whole mesh.
module gimp_mesh_file
  use gimp_kinds, only: wp, dp, i8
  use gimp_error, only: error_t, raise, add_error
  use gimp_text, only: text_of
  use gimp_over_ranks, only: share_error
  use gimp_hdf5, only: hdf5_file_t, open_hdf5, close_hdf5, has_dataset, has_attribute, read_attribute, read_dataset, dataset_shape, &
    members_of_group
  use gimp_mesh, only: mesh_t, kind_name, kind_nodes, kind_dim, n_kinds, triangle3, triangle6, tetrahedron4, most_side_corners, &
    group_name_length
  use gimp_elements, only: element_volume
  use gimp_mesh_connect, only: connect_mesh
  use gimp_mesh_checks, only: check_numbers, check_elements
  use gimp_mesh_conformity, only: check_conformity
  implicit none(type, external)
  private
  public :: read_mesh

  integer, parameter :: version = 1 !! of the format
  integer, parameter :: most_rows = 2*10**8 !! nodes or elements, so that default integers count their sides too

contains

  !> Read a mesh, check it and connect it (again after renumbering): every mistake is told, the same on all ranks. Collective
  subroutine read_mesh(path, dim, lower, spacing, mesh, error)
    character(len=*), intent(in) :: path
    integer, intent(in) :: dim !! of the scene: 1, 2 or 3
    real(dp), intent(out) :: lower(:) !! smallest coordinates of its nodes, the origin of places in cells [m]; 0 beyond the dimension
    real(dp), intent(inout) :: spacing !! what is to be one cell [m]; <= 0: the edge of an element of mean size, which it then becomes
    type(mesh_t), intent(out) :: mesh
    type(error_t), allocatable, intent(out) :: error
    call read_and_check(path, dim, lower, spacing, mesh, error)
    call share_error(error)
  end subroutine read_mesh

  subroutine read_and_check(path, dim, lower, spacing, mesh, error)
    character(len=*), intent(in) :: path
    integer, intent(in) :: dim
    real(dp), intent(out) :: lower(:)
    real(dp), intent(inout) :: spacing
    type(mesh_t), intent(out) :: mesh
    type(error_t), allocatable, intent(out) :: error
    type(hdf5_file_t) :: file
    type(error_t), allocatable :: ignored
    real(dp), allocatable :: x(:, :)
    lower = 0.0_dp
    call open_hdf5(path, "read", file, error)
    if (allocated(error)) return
    call check_header(file, dim, error)
    if (.not. allocated(error)) call read_tables(file, dim, mesh, x, error)
    call close_hdf5(file, ignored) ! nothing can be lost by reading
    if (.not. allocated(error)) call check_numbers(path, mesh, x, error)
    if (allocated(error)) return
    lower(:dim) = minval(x, dim=2)
    if (.not. spacing > 0.0_dp) then
      spacing = mean_size(mesh, x)
      if (.not. spacing > 0.0_dp) then
        call raise(error, path//": no element of the mesh has a volume (are its coordinates those of another dimension?)")
        return
      end if
    end if
    call to_cells(x, lower, spacing, mesh)
    call check_elements(path, mesh, error)
    if (allocated(error)) return ! what follows would tell the same once more
    call connect_mesh(mesh)
    call check_conformity(path, mesh, error)
  end subroutine read_and_check

  !> Whether this is a mesh file, of this version and dimension
  subroutine check_header(file, dim, error)
    type(hdf5_file_t), intent(in) :: file
    integer, intent(in) :: dim
    type(error_t), allocatable, intent(out) :: error
    type(error_t), allocatable :: fault
    character(len=:), allocatable :: format
    integer(i8) :: number
    call read_attribute(file, "", "format", format, fault)
    if (.not. allocated(fault)) then
      if (format /= "gimp-mesh") call raise(fault, "another format")
    end if
    if (allocated(fault)) then
      call raise(error, file%path//": is not a mesh file (its attribute format must be gimp-mesh); preprocessing/convert_mesh.py makes one " &
        //"of meshes in other formats")
      return
    end if
    call read_attribute(file, "", "version", number, error)
    if (.not. allocated(error) .and. number /= version) call raise(error, file%path//": has version "//text_of(number) &
      //" of the mesh format; this program reads version "//text_of(version)//"; convert the mesh again")
    if (allocated(error)) return
    call read_attribute(file, "", "dimension", number, error)
    if (.not. allocated(error) .and. number /= dim) call raise(error, file%path//": holds a mesh in "//text_of(number) &
      //" dimensions; the scene has "//text_of(dim))
  end subroutine check_header

  !> Everything that the file holds. Numbers of nodes and groups out of range stay so (`check_numbers` tells them)
  subroutine read_tables(file, dim, mesh, x, error)
    type(hdf5_file_t), intent(in) :: file
    integer, intent(in) :: dim
    type(mesh_t), intent(inout) :: mesh
    real(dp), allocatable, intent(out) :: x(:, :) !! (dim, node) places of the nodes [m]
    type(error_t), allocatable, intent(out) :: error
    integer(i8) :: rows
    integer :: i
    mesh%dim = dim
    call count_rows(file, "nodes", dim, rows, error)
    if (.not. allocated(error)) then
      if (rows == 0) call raise(error, file%path//": holds no nodes")
      if (rows > most_rows) call raise(error, file%path//": holds more than "//text_of(most_rows)//" nodes")
    end if
    if (.not. allocated(error)) call read_dataset(file, "nodes", x, error)
    if (allocated(error)) return
    mesh%nodes = int(rows)
    mesh%node_in_file = [(i, i=1, mesh%nodes)]
    call read_elements(file, mesh, error)
    call read_names(file, "element_groups", mesh%element_group_name, error)
    call read_names(file, "side_groups", mesh%side_group_name, error)
    call read_sides(file, mesh, error)
  end subroutine read_tables

  !> Elements in the order of kinds, with their groups
  subroutine read_elements(file, mesh, error)
    type(hdf5_file_t), intent(in) :: file
    type(mesh_t), intent(inout) :: mesh
    type(error_t), allocatable, intent(inout) :: error
    type(error_t), allocatable :: fault
    integer(i8) :: rows(n_kinds)
    integer :: k, e
    call refuse_other_tables(file, mesh%dim, error)
    rows = 0
    do k = 1, n_kinds
      if (kind_dim(k) /= mesh%dim) cycle
      if (.not. has_dataset(file, table(k))) cycle
      call count_rows(file, table(k), kind_nodes(k), rows(k), fault)
      if (allocated(fault)) call add_error(error, fault%message)
    end do
    if (sum(rows) > most_rows) call add_error(error, file%path//": holds more than "//text_of(most_rows)//" elements")
    if (allocated(error)) return
    if (sum(rows) == 0) then
      call add_error(error, file%path//": holds no elements of dimension "//text_of(mesh%dim))
      return
    end if
    mesh%elements = int(sum(rows))
    allocate (mesh%kind(mesh%elements), mesh%element_in_file(mesh%elements), mesh%element_group(mesh%elements), source=0)
    allocate (mesh%node(maxval(kind_nodes, mask=rows > 0), mesh%elements), source=0)
    e = 0
    do k = 1, n_kinds
      if (rows(k) > 0) call read_kind(file, k, int(rows(k)), e, mesh, error)
      e = e + int(rows(k))
    end do
  end subroutine read_elements

  !> The elements of one kind, behind e others
  subroutine read_kind(file, kind, n, e, mesh, error)
    type(hdf5_file_t), intent(in) :: file
    integer, intent(in) :: kind, n, e
    type(mesh_t), intent(inout) :: mesh
    type(error_t), allocatable, intent(inout) :: error
    type(error_t), allocatable :: fault
    integer(i8), allocatable :: node(:, :), group(:)
    integer :: i
    mesh%kind(e + 1:e + n) = kind
    mesh%element_in_file(e + 1:e + n) = [(i, i=1, n)]
    call read_dataset(file, table(kind), node, fault)
    if (.not. allocated(fault)) then
      mesh%node(:kind_nodes(kind), e + 1:e + n) = in_range(node, mesh%nodes)
      if (.not. has_dataset(file, table(kind)//"_group")) return
      call read_dataset(file, table(kind)//"_group", group, fault)
    end if
    if (.not. allocated(fault)) then
      if (size(group) == n) then
        mesh%element_group(e + 1:e + n) = in_range(group, huge(0) - 1)
      else
        call raise(fault, file%path//": "//table(kind)//"_group has "//text_of(size(group))//" values for "//text_of(n)//" elements")
      end if
    end if
    if (allocated(fault)) call add_error(error, fault%message)
  end subroutine read_kind

  !> Tables that are not of this dimension, or that nothing is known of, are no elements of this mesh
  subroutine refuse_other_tables(file, dim, error)
    type(hdf5_file_t), intent(in) :: file
    integer, intent(in) :: dim
    type(error_t), allocatable, intent(inout) :: error
    character(len=64), allocatable :: names(:)
    character(len=:), allocatable :: known
    integer :: i, k
    known = ""
    do k = 1, n_kinds
      if (kind_dim(k) == dim) known = known//" "//trim(kind_name(k))
    end do
    call members_of_group(file, "elements", names)
    do i = 1, size(names)
      if (any(names(i) == kind_name .and. kind_dim == dim)) cycle
      if (any(names(i) == kind_name)) then
        call add_error(error, file%path//": elements/"//trim(names(i))//" in a mesh of dimension "//text_of(dim)//": all elements have its " &
          //"dimension, those around it go to sides/nodes")
      else if (.not. any([(names(i) == trim(kind_name(k))//"_group", k=1, n_kinds)])) then
        call add_error(error, file%path//": elements/"//trim(names(i))//" is no kind of element known here; in "//text_of(dim) &
          //" dimensions there are:"//known)
      else if (.not. has_dataset(file, "elements/"//names(i)(:index(names(i), "_group") - 1))) then
        call add_error(error, file%path//": elements/"//trim(names(i))//" belongs to elements that are not there")
      end if
    end do
  end subroutine refuse_other_tables

  !> Sides that have a name
  subroutine read_sides(file, mesh, error)
    type(hdf5_file_t), intent(in) :: file
    type(mesh_t), intent(inout) :: mesh
    type(error_t), allocatable, intent(inout) :: error
    type(error_t), allocatable :: fault
    character(len=64), allocatable :: names(:)
    integer(i8), allocatable :: node(:, :), group(:)
    integer(i8) :: rows
    allocate (mesh%named_side_node(most_side_corners, 0), mesh%named_side_group(0))
    call members_of_group(file, "sides", names)
    if (size(names) == 0) return
    call count_rows(file, "sides/nodes", most_side_corners, rows, fault)
    if (.not. allocated(fault)) call read_dataset(file, "sides/nodes", node, fault)
    if (.not. allocated(fault)) call read_dataset(file, "sides/group", group, fault)
    if (.not. allocated(fault)) then
      if (size(group) /= rows) call raise(fault, file%path//": sides/group has "//text_of(size(group))//" values for "//text_of(rows)//" sides")
    end if
    if (allocated(fault)) then
      call add_error(error, fault%message)
      return
    end if
    mesh%named_side_node = in_range(node, mesh%nodes)
    mesh%named_side_group = in_range(group, huge(0) - 1)
  end subroutine read_sides

  !> Names of groups: an attribute with new lines between them
  subroutine read_names(file, name, names, error)
    type(hdf5_file_t), intent(in) :: file
    character(len=*), intent(in) :: name
    character(len=group_name_length), allocatable, intent(out) :: names(:)
    type(error_t), allocatable, intent(inout) :: error
    type(error_t), allocatable :: fault
    character(len=:), allocatable :: text
    integer :: last
    allocate (names(0))
    if (.not. has_attribute(file, "", name)) return
    call read_attribute(file, "", name, text, fault)
    if (allocated(fault)) then
      call add_error(error, fault%message)
      return
    end if
    do while (len(text) > 0)
      last = index(text//new_line("a"), new_line("a")) - 1
      if (last == 0 .or. last > group_name_length) then
        call add_error(error, file%path//": "//name//": '"//text(:last)//"' is no name of a group; it has 1 to " &
          //text_of(group_name_length)//" letters")
      else if (any(names == text(:last))) then
        call add_error(error, file%path//": "//name//": '"//text(:last)//"' is there twice; a name may be given once")
      end if
      names = [character(len=group_name_length) :: names, text(:last)]
      text = text(min(last + 2, len(text) + 1):)
    end do
  end subroutine read_names

  !> The path of the table of a kind
  pure function table(kind) result(path)
    integer, intent(in) :: kind
    character(len=:), allocatable :: path
    path = "elements/"//trim(kind_name(kind))
  end function table

  !> Rows of a table that must have so many columns
  subroutine count_rows(file, path, columns, rows, error)
    type(hdf5_file_t), intent(in) :: file
    character(len=*), intent(in) :: path
    integer, intent(in) :: columns
    integer(i8), intent(out) :: rows
    type(error_t), allocatable, intent(out) :: error
    integer(i8), allocatable :: extents(:)
    rows = 0
    call dataset_shape(file, path, extents, error)
    if (allocated(error)) return
    if (size(extents) /= 2) then
      call raise(error, file%path//": "//path//" has "//text_of(size(extents))//" dimensions; must be (rows, "//text_of(columns)//")")
    else if (extents(1) /= columns) then
      call raise(error, file%path//": "//path//" has "//text_of(extents(1))//" columns; must have "//text_of(columns))
    else
      rows = extents(2)
    end if
  end subroutine count_rows

  !> A number from the file as one of -1 .. most + 1: what is out of range stays so
  elemental integer function in_range(number, most)
    integer(i8), intent(in) :: number
    integer, intent(in) :: most
    in_range = int(max(-1_i8, min(number, most + 1_i8)))
  end function in_range

  !> The edge of a square or cube of the mean size of elements [m]; two triangles count as one square, six tetrahedra as one cube
  pure real(dp) function mean_size(mesh, x)
    type(mesh_t), intent(in) :: mesh
    real(dp), intent(in) :: x(:, :) !! [m]
    real(dp) :: total, share
    integer :: e
    total = 0.0_dp
    do e = 1, mesh%elements
      share = 1.0_dp
      if (mesh%kind(e) == triangle3 .or. mesh%kind(e) == triangle6) share = 2.0_dp
      if (mesh%kind(e) == tetrahedron4) share = 6.0_dp
      total = total + share*abs(element_volume(mesh%kind(e), real(x(:, mesh%node(:kind_nodes(mesh%kind(e)), e)), wp)))
    end do
    mean_size = (total/mesh%elements)**(1.0_dp/mesh%dim)
  end function mean_size

  !> Places in cells from the corner of the box
  pure subroutine to_cells(x, lower, spacing, mesh)
    real(dp), intent(in) :: x(:, :), lower(:), spacing !! [m]
    type(mesh_t), intent(inout) :: mesh
    integer :: d
    allocate (mesh%x(mesh%dim, mesh%nodes))
    do d = 1, mesh%dim
      mesh%x(d, :) = real((x(d, :) - lower(d))/spacing, wp)
    end do
  end subroutine to_cells

end module gimp_mesh_file
