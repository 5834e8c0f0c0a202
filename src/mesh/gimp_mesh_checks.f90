!> Mistakes in the numbers and the elements of a mesh file. Messages name elements by their numbers in the file, and say what to do
module gimp_mesh_checks
  use gimp_kinds, only: wp, dp
  use gimp_error, only: error_t, add_error
  use gimp_text, only: text_of
  use gimp_mesh, only: mesh_t, kind_nodes, kind_corners, element_label, triangle3, triangle6, tetrahedron4
  use gimp_elements, only: element_volume, element_height, smallest_jacobian
  implicit none(type, external)
  private
  public :: check_numbers, check_elements, list_t, add_item, tell_list, node_label

  real(wp), parameter, public :: least_jacobian = 0.05_wp !! an element whose least det J is a smaller share of its mean is refused
  real(wp), parameter, public :: least_height = 0.01_wp !! so is a simplex whose smallest height is a smaller share of its longest edge
  real(wp), parameter :: flat = 1.0e-10_wp !! share of longest edge**dim that is no volume
  integer, parameter :: handful = 5 !! items that a message names
  integer, parameter :: sound = 0, is_empty = 1, is_inverted = 2, is_bad = 3, is_thin = 4 !! shapes

  !> Items found faulty, of which a message names the first
  type :: list_t
    integer :: n = 0
    character(len=:), allocatable :: text
  end type list_t

contains

  !> One more item
  pure subroutine add_item(list, item)
    type(list_t), intent(inout) :: list
    character(len=*), intent(in) :: item
    list%n = list%n + 1
    if (list%n == 1) list%text = item
    if (list%n > 1 .and. list%n <= handful) list%text = list%text//", "//item
  end subroutine add_item

  !> A message about the items of a list, if there are any
  pure subroutine tell_list(path, what, list, remedy, error)
    character(len=*), intent(in) :: path, what, remedy
    type(list_t), intent(in) :: list
    type(error_t), allocatable, intent(inout) :: error
    character(len=:), allocatable :: more
    if (list%n == 0) return
    more = ""
    if (list%n > handful) more = " and "//text_of(list%n - handful)//" more"
    call add_error(error, path//": "//what//": "//list%text//more//"; "//remedy)
  end subroutine tell_list

  pure function node_label(mesh, node) result(label)
    type(mesh_t), intent(in) :: mesh
    integer, intent(in) :: node
    character(len=:), allocatable :: label
    label = "node "//text_of(mesh%node_in_file(node))
  end function node_label

  !> Numbers of nodes and groups that are out of range, coordinates that are no numbers
  pure subroutine check_numbers(path, mesh, x, error)
    character(len=*), intent(in) :: path
    type(mesh_t), intent(in) :: mesh
    real(dp), intent(in) :: x(:, :) !! (dim, node) [m]
    type(error_t), allocatable, intent(inout) :: error
    type(list_t) :: places, missing, groups
    integer :: i, e, n
    do i = 1, mesh%nodes
      if (.not. all(is_number(x(:, i)))) call add_item(places, node_label(mesh, i))
    end do
    call tell_list(path, "coordinates that are not finite numbers", places, "correct or remove these nodes", error)
    do e = 1, mesh%elements
      n = kind_nodes(mesh%kind(e))
      if (any(mesh%node(:n, e) < 1 .or. mesh%node(:n, e) > mesh%nodes)) call add_item(missing, element_label(mesh, e))
      if (mesh%element_group(e) < 0 .or. mesh%element_group(e) > size(mesh%element_group_name)) &
        call add_item(groups, element_label(mesh, e))
    end do
    call tell_list(path, "elements with nodes that are not there", missing, "nodes are numbered from 1 to "//text_of(mesh%nodes), error)
    call tell_list(path, "elements in a group that is not there", groups, "groups are numbered from 1 to " &
      //text_of(size(mesh%element_group_name))//" as in the attribute element_groups, 0 is none", error)
    call check_named_sides(path, mesh, error)
  end subroutine check_numbers

  !> The same for named sides
  pure subroutine check_named_sides(path, mesh, error)
    character(len=*), intent(in) :: path
    type(mesh_t), intent(in) :: mesh
    type(error_t), allocatable, intent(inout) :: error
    type(list_t) :: missing, groups
    integer :: k
    do k = 1, size(mesh%named_side_group)
      if (any(mesh%named_side_node(:, k) < 0 .or. mesh%named_side_node(:, k) > mesh%nodes) .or. all(mesh%named_side_node(:, k) == 0)) &
        call add_item(missing, "side "//text_of(k))
      if (mesh%named_side_group(k) < 1 .or. mesh%named_side_group(k) > size(mesh%side_group_name)) &
        call add_item(groups, "side "//text_of(k))
    end do
    call tell_list(path, "rows of sides/nodes with nodes that are not there", missing, "nodes are numbered from 1 to " &
      //text_of(mesh%nodes)//", 0 fills up", error)
    call tell_list(path, "rows of sides/group that name no group", groups, "groups are numbered from 1 to " &
      //text_of(size(mesh%side_group_name))//" as in the attribute side_groups", error)
  end subroutine check_named_sides

  !> Elements that are wrong by themselves or twice there, nodes without an element. Numbers must be in range
  subroutine check_elements(path, mesh, error)
    character(len=*), intent(in) :: path
    type(mesh_t), intent(in) :: mesh
    type(error_t), allocatable, intent(inout) :: error
    type(list_t) :: repeats, unused
    integer :: i, e
    logical, allocatable :: used(:)
    allocate (used(mesh%nodes), source=.false.)
    do e = 1, mesh%elements
      used(mesh%node(:kind_nodes(mesh%kind(e)), e)) = .true.
      if (has_repeats(mesh, e)) call add_item(repeats, element_label(mesh, e))
    end do
    do i = 1, mesh%nodes
      if (.not. used(i)) call add_item(unused, node_label(mesh, i))
    end do
    call tell_list(path, "elements with the same node twice", repeats, &
      "give them distinct nodes (an element with an edge of no length is one of another kind)", error)
    call tell_list(path, "nodes that no element has", unused, "remove them (preprocessing/convert_mesh.py does)", error)
    call check_duplicates(path, mesh, error)
    call check_shapes(path, mesh, error)
  end subroutine check_elements

  pure logical function has_repeats(mesh, e)
    type(mesh_t), intent(in) :: mesh
    integer, intent(in) :: e
    integer :: k
    has_repeats = .false.
    do k = 2, kind_nodes(mesh%kind(e))
      has_repeats = has_repeats .or. any(mesh%node(:k - 1, e) == mesh%node(k, e))
    end do
  end function has_repeats

  !> Elements between the corners of another; each is listed under the highest of its corners
  pure subroutine check_duplicates(path, mesh, error)
    character(len=*), intent(in) :: path
    type(mesh_t), intent(in) :: mesh
    type(error_t), allocatable, intent(inout) :: error
    type(list_t) :: twice
    integer, allocatable :: first(:), next(:)
    integer :: e, other, corners, highest
    allocate (first(mesh%nodes), next(mesh%elements), source=0)
    do e = 1, mesh%elements
      corners = kind_corners(mesh%kind(e))
      highest = maxval(mesh%node(:corners, e))
      other = first(highest)
      do while (other > 0)
        if (kind_corners(mesh%kind(other)) == corners .and. same_nodes(mesh%node(:, e), mesh%node(:, other), corners)) exit
        other = next(other)
      end do
      if (other > 0) call add_item(twice, element_label(mesh, e)//" (as "//element_label(mesh, other)//")")
      next(e) = first(highest)
      first(highest) = e
    end do
    call tell_list(path, "elements that are there twice", twice, "remove one of each", error)
  end subroutine check_duplicates

  !> Whether the first n of two lists are the same, in any order
  pure logical function same_nodes(a, b, n)
    integer, intent(in) :: a(:), b(:), n
    integer :: k
    same_nodes = .true.
    do k = 1, n
      same_nodes = same_nodes .and. any(b(:n) == a(k))
    end do
  end function same_nodes

  !> Elements that are inside out, flat or far from regular
  subroutine check_shapes(path, mesh, error)
    character(len=*), intent(in) :: path
    type(mesh_t), intent(in) :: mesh
    type(error_t), allocatable, intent(inout) :: error
    type(list_t) :: empty, inverted, bad, thin
    integer, allocatable :: fault(:)
    real(wp), allocatable :: share(:)
    integer :: e
    allocate (fault(mesh%elements), share(mesh%elements))
    !$omp parallel do schedule(static)
    do e = 1, mesh%elements
      call look_at(mesh%kind(e), mesh%x(:, mesh%node(:kind_nodes(mesh%kind(e)), e)), fault(e), share(e))
    end do
    !$omp end parallel do
    do e = 1, mesh%elements
      if (fault(e) == sound) cycle
      if (has_repeats(mesh, e)) cycle ! that is told
      if (fault(e) == is_empty) call add_item(empty, element_label(mesh, e))
      if (fault(e) == is_inverted) call add_item(inverted, element_label(mesh, e))
      if (fault(e) == is_bad) call add_item(bad, element_label(mesh, e)//" ("//text_of(share(e), 2)//")")
      if (fault(e) == is_thin) call add_item(thin, element_label(mesh, e)//" ("//text_of(share(e), 2)//")")
    end do
    call tell_list(path, "elements without volume", empty, "their nodes lie on a line or plane: move nodes or leave the elements out", error)
    call tell_list(path, "inverted elements (negative volume)", inverted, "reverse the order of their nodes (corners counter-clockwise, " &
      //"as VTK has them)", error)
    call tell_list(path, "badly shaped elements (smallest Jacobian over its mean)", bad, "must be at least "//text_of(least_jacobian) &
      //": check the order of their nodes, or mesh that place anew without corners near 180 degrees", error)
    call tell_list(path, "badly shaped elements (smallest height over longest edge)", thin, "must be at least "//text_of(least_height) &
      //": mesh that place anew without needles and slivers", error)
  end subroutine check_shapes

  !> What is wrong with the shape of an element, and the number that says so
  pure subroutine look_at(kind, xe, fault, share)
    integer, intent(in) :: kind
    real(wp), intent(in) :: xe(:, :) !! (dim, node)
    integer, intent(out) :: fault
    real(wp), intent(out) :: share
    real(wp) :: volume, edge
    fault = sound
    volume = element_volume(kind, xe)
    edge = longest_distance(xe(:, :kind_corners(kind)))
    share = 0.0_wp
    if (edge > 0.0_wp) share = volume/edge**size(xe, 1)
    if (share < -flat) fault = is_inverted
    if (abs(share) <= flat) fault = is_empty
    if (fault /= sound) return
    share = smallest_jacobian(kind, xe)
    if (share < least_jacobian) fault = is_bad
    if (fault /= sound .or. .not. is_simplex(kind)) return
    share = element_height(kind, xe)/edge
    if (share < least_height) fault = is_thin
  end subroutine look_at

  pure logical function is_simplex(kind)
    integer, intent(in) :: kind
    is_simplex = kind == triangle3 .or. kind == triangle6 .or. kind == tetrahedron4
  end function is_simplex

  !> The longest distance between any two of some points
  pure real(wp) function longest_distance(x) result(longest)
    real(wp), intent(in) :: x(:, :)
    integer :: i, k
    longest = 0.0_wp
    do i = 2, size(x, 2)
      do k = 1, i - 1
        longest = max(longest, norm2(x(:, i) - x(:, k)))
      end do
    end do
  end function longest_distance

  !> Neither infinite nor NaN; the first comparison keeps NaN from raising an exception in the second
  elemental logical function is_number(value)
    real(dp), intent(in) :: value
    is_number = .false.
    if (value /= value) return
    is_number = abs(value) <= huge(value)
  end function is_number

end module gimp_mesh_checks
