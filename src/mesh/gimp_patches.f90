!> Patches of elements, which play the part of blocks on an unstructured mesh.
!>
!> A patch holds elements of one kind, about as many as have 64 nodes; patches are cut when the mesh is read and do not depend on
!> threads or ranks. Elements and nodes are numbered anew, patch by patch, so that a slot of 64 consecutive nodes lies in one
!> place. The pad of a patch is the list of nodes that its particles may give to: first those of its own elements (core), then
!> those that domains of particles in these may reach (inner), then those of particles that have strayed into the ring of
!> elements around the patch.
module gimp_patches
  use gimp_kinds, only: wp, i8
  use gimp_sorting, only: sort_order
  use gimp_grid, only: nodes_per_block
  use gimp_mesh, only: mesh_t, n_kinds, kind_dim, kind_nodes, kind_corners
  use gimp_mesh_renumber, only: renumber_mesh
  use gimp_elements, only: element_volume, element_height
  implicit none(type, external)
  private
  public :: patches_t, make_patches, make_pads, slot_of, place_of, cell_of_element

  !> Elements of a patch, by kind: about 64 nodes each
  integer, parameter :: elements_in_patch(n_kinds) = [64, 128, 32, 64, 21, 16, 320, 64]
  integer, parameter :: at_once = 16 !! boxes that are looked at together
  integer, parameter :: axis_bits = 20 !! of the places of patches on the curve that orders them

  type :: patches_t
    integer :: n = 0
    integer :: slots = 0 !! of 64 nodes
    integer :: most_pad = 0 !! nodes of the largest pad
    integer :: most_near = 0 !! slots of the pad that has most
    integer :: most_touch = 0 !! pads of the slot that has most
    integer, allocatable :: first(:) !! (patch + 1) its elements
    integer, allocatable :: of_element(:) !! (element) its patch
    integer, allocatable :: pad_first(:) !! (patch + 1) where its nodes begin in `pad_node`
    integer, allocatable :: pad_node(:) !! nodes of pads
    integer, allocatable :: pad_near(:) !! which of the slots of its patch a node of a pad is in
    integer, allocatable :: core(:), inner(:) !! (patch) first nodes of its pad: of its own elements; and of those in reach of them
    integer, allocatable :: near_first(:), near(:) !! (patch + 1) slots of its pad, ascending
    integer, allocatable :: touch_first(:), touch(:) !! (slot + 1) patches whose pads have nodes in it, ascending
    integer, allocatable :: give_first(:) !! (slot + 1) the nodes of pads that are nodes of a slot, in the order of patches:
    integer, allocatable :: give_touch(:), give_pad(:), give_place(:) !! which of the patches that touch it, node of the pad, place in the slot
    real(wp), allocatable :: height(:) !! (patch) least height of an element of it or of the ring around it: for time steps [cells]
    real(wp), allocatable :: width(:) !! (patch) size of its elements: for the length of domains [cells]
  end type patches_t

contains

  !> Slot of a node, from 0, and its place there, from 1
  pure elemental integer function slot_of(node)
    integer, intent(in) :: node
    slot_of = (node - 1)/nodes_per_block
  end function slot_of

  pure elemental integer function place_of(node)
    integer, intent(in) :: node
    place_of = 1 + modulo(node - 1, nodes_per_block)
  end function place_of

  !> Which of 64 parts of a patch an element is in, from 0: sorts bring particles into this order
  pure integer function cell_of_element(patches, patch, element) result(cell)
    type(patches_t), intent(in) :: patches
    integer, intent(in) :: patch, element
    cell = nodes_per_block*(element - patches%first(patch))/(patches%first(patch + 1) - patches%first(patch))
  end function cell_of_element

  ! ------------------------------------------------------------------------------------------------ patches

  !> Cut the elements into patches, and number elements and nodes anew. Connections of the mesh are to be made afterwards
  subroutine make_patches(mesh, patches)
    type(mesh_t), intent(inout) :: mesh
    type(patches_t), intent(out) :: patches
    real(wp), allocatable :: center(:, :) ! (dim, element)
    integer, allocatable :: list(:), last(:), order(:), element_order(:), node_order(:)
    integer :: kind, e, n, p, q, k
    allocate (center(mesh%dim, mesh%elements), list(mesh%elements), last(mesh%elements))
    do e = 1, mesh%elements
      center(:, e) = center_of(mesh, e)
    end do
    n = 0
    p = 0
    do kind = 1, n_kinds
      k = n
      do e = 1, mesh%elements
        if (mesh%kind(e) /= kind) cycle
        n = n + 1
        list(n) = e
      end do
      if (n > k) call cut_list(center, list, k + 1, n, elements_in_patch(kind), p, last)
    end do
    call order_patches(center, list, last(:p), order)
    patches%n = p
    allocate (patches%first(p + 1), patches%of_element(mesh%elements), element_order(mesh%elements))
    patches%first(1) = 1
    do q = 1, p
      k = 1
      if (order(q) > 1) k = last(order(q) - 1) + 1
      n = last(order(q)) - k + 1
      patches%first(q + 1) = patches%first(q) + n
      element_order(patches%first(q):patches%first(q) + n - 1) = ascending(list(k:k + n - 1))
      patches%of_element(patches%first(q):patches%first(q) + n - 1) = q
    end do
    call number_nodes(mesh, element_order, node_order)
    call renumber_mesh(mesh, element_order, node_order)
    patches%slots = slot_of(mesh%nodes) + 1
  end subroutine make_patches

  pure function center_of(mesh, e) result(center)
    type(mesh_t), intent(in) :: mesh
    integer, intent(in) :: e
    real(wp) :: center(mesh%dim)
    integer :: k
    center = 0.0_wp
    do k = 1, kind_corners(mesh%kind(e))
      center = center + mesh%x(:, mesh%node(k, e))
    end do
    center = center/kind_corners(mesh%kind(e))
  end function center_of

  !> Halve a list of elements across its longest side until the parts are small enough
  recursive subroutine cut_list(center, list, from, to, most, parts, last)
    real(wp), intent(in) :: center(:, :)
    integer, intent(inout) :: list(:), last(:), parts
    integer, intent(in) :: from, to, most
    real(wp) :: low(size(center, 1)), high(size(center, 1))
    integer :: k, axis, middle, whole
    if (to - from + 1 <= most) then
      parts = parts + 1
      last(parts) = to
      return
    end if
    low = center(:, list(from))
    high = low
    do k = from + 1, to
      low = min(low, center(:, list(k)))
      high = max(high, center(:, list(k)))
    end do
    axis = maxloc(high - low, dim=1)
    whole = (to - from + most)/most ! parts that this list makes
    middle = from + int(int(to - from + 1, i8)*(whole/2)/whole) - 1
    call split_list(center(axis, :), list, from, to, middle)
    call cut_list(center, list, from, middle, most, parts, last)
    call cut_list(center, list, middle + 1, to, most, parts, last)
  end subroutine cut_list

  !> Bring the elements with the smallest coordinates to the places up to `middle` (quickselect; equal ones by their numbers, so that
  !> which come first does not depend on the way)
  pure subroutine split_list(x, list, from, to, middle)
    real(wp), intent(in) :: x(:)
    integer, intent(inout) :: list(:)
    integer, intent(in) :: from, to, middle
    integer :: low, high, i, j, pivot, other
    low = from
    high = to
    do while (low < high)
      pivot = list((low + high)/2)
      i = low
      j = high
      do while (i <= j)
        do while (comes_before(list(i), pivot))
          i = i + 1
        end do
        do while (comes_before(pivot, list(j)))
          j = j - 1
        end do
        if (i > j) exit
        other = list(i)
        list(i) = list(j)
        list(j) = other
        i = i + 1
        j = j - 1
      end do
      if (middle <= j) then
        high = j
      else if (middle >= i) then
        low = i
      else
        exit
      end if
    end do

  contains

    pure logical function comes_before(a, b)
      integer, intent(in) :: a, b
      comes_before = x(a) < x(b) .or. (.not. x(b) < x(a) .and. a < b)
    end function comes_before

  end subroutine split_list

  !> Patches along a space-filling curve (Morton order of their centres), so that consecutive ones are near each other
  subroutine order_patches(center, list, last, order)
    real(wp), intent(in) :: center(:, :)
    integer, intent(in) :: list(:), last(:)
    integer, allocatable, intent(out) :: order(:)
    integer(i8) :: key(size(last))
    real(wp) :: at(size(center, 1), size(last)), low(size(center, 1)), widest
    integer :: p, k, first, bit, place
    first = 1
    do p = 1, size(last)
      do k = 1, size(center, 1)
        at(k, p) = sum(center(k, list(first:last(p))))/(last(p) - first + 1)
      end do
      first = last(p) + 1
    end do
    low = minval(at, dim=2)
    widest = max(maxval(maxval(at, dim=2) - low), tiny(1.0_wp))
    key = 0
    do p = 1, size(last)
      do k = 1, size(center, 1)
        place = int((2**axis_bits - 1)*((at(k, p) - low(k))/widest))
        do bit = 0, axis_bits - 1
          if (btest(place, bit)) key(p) = ibset(key(p), 3*bit + k - 1)
        end do
      end do
    end do
    call sort_order(key, order)
  end subroutine order_patches

  function ascending(list) result(sorted)
    integer, intent(in) :: list(:)
    integer :: sorted(size(list))
    integer, allocatable :: order(:)
    call sort_order(int(list, i8), order)
    sorted = list(order)
  end function ascending

  !> Nodes in the order in which the elements name them
  pure subroutine number_nodes(mesh, element_order, node_order)
    type(mesh_t), intent(in) :: mesh
    integer, intent(in) :: element_order(:)
    integer, allocatable, intent(out) :: node_order(:)
    logical :: seen(mesh%nodes)
    integer :: e, k, n, node
    allocate (node_order(mesh%nodes))
    seen = .false.
    n = 0
    do e = 1, size(element_order)
      do k = 1, kind_nodes(mesh%kind(element_order(e)))
        node = mesh%node(k, element_order(e))
        if (seen(node)) cycle
        seen(node) = .true.
        n = n + 1
        node_order(n) = node
      end do
    end do
    do node = 1, mesh%nodes ! nodes of no element come last
      if (seen(node)) cycle
      n = n + 1
      node_order(n) = node
    end do
  end subroutine number_nodes

  ! ------------------------------------------------------------------------------------------------ pads

  !> Pads of all patches of a connected mesh: which nodes particles may give to from their elements
  subroutine make_pads(mesh, patches, reach, rings)
    type(mesh_t), intent(in) :: mesh
    type(patches_t), intent(inout) :: patches
    real(wp), intent(in) :: reach !! of domains beyond the centres of their particles, in sizes of elements; 0: the particles' own elements
    integer, intent(in) :: rings !! of elements around these that are wanted all the same (smeared gradients)
    real(wp), allocatable :: low(:, :), high(:, :)
    integer, allocatable :: stamp_element(:), stamp_node(:), region(:), list(:)
    integer, allocatable :: seen(:) ! by the walk of this number
    integer :: walk, p, own, near, n, e
    allocate (low(mesh%dim, mesh%elements), high(mesh%dim, mesh%elements), region(mesh%elements), list(mesh%elements))
    allocate (stamp_element(mesh%elements), stamp_node(mesh%nodes), seen(mesh%elements), source=0)
    allocate (patches%core(patches%n), patches%inner(patches%n), patches%pad_first(patches%n + 1), patches%pad_node(4*mesh%nodes + 64))
    call measure(mesh, patches)
    do e = 1, mesh%elements
      associate (nodes => mesh%node(:kind_nodes(mesh%kind(e)), e))
        low(:, e) = minval(mesh%x(:, nodes), dim=2)
        high(:, e) = maxval(mesh%x(:, nodes), dim=2)
      end associate
    end do
    walk = 0
    n = 0
    do p = 1, patches%n
      patches%pad_first(p) = n + 1
      own = 0
      do e = patches%first(p), patches%first(p + 1) - 1
        own = own + 1
        region(own) = e
        stamp_element(e) = p
      end do
      call note_nodes(1, own)
      patches%core(p) = n + 1 - patches%pad_first(p)
      near = own
      call extend(near) ! own elements and what domains reach from there
      call note_nodes(own + 1, near)
      patches%inner(p) = n + 1 - patches%pad_first(p)
      own = near
      call extend_from_ring(near) ! the same of particles in the ring around the patch
      call note_nodes(own + 1, near)
    end do
    patches%pad_first(patches%n + 1) = n + 1
    patches%pad_node = patches%pad_node(:n)
    patches%most_pad = maxval(patches%pad_first(2:) - patches%pad_first(:patches%n))
    call find_slots(patches)

  contains

    !> Nodes of elements of the region that the pad does not have
    subroutine note_nodes(first, last)
      integer, intent(in) :: first, last
      integer :: i, k, node
      do i = first, last
        do k = 1, kind_nodes(mesh%kind(region(i)))
          node = mesh%node(k, region(i))
          if (stamp_node(node) == p) cycle
          stamp_node(node) = p
          n = n + 1
          if (n > size(patches%pad_node)) patches%pad_node = [patches%pad_node, patches%pad_node]
          patches%pad_node(n) = node
        end do
      end do
    end subroutine note_nodes

    !> All elements within reach of those of the patch, and rings around them
    subroutine extend(members)
      integer, intent(inout) :: members
      call add_in_reach_of([region(:members)], members)
      call add_rings(members)
    end subroutine extend

    !> The ring around the patch, all elements within reach of it and of the patch, and rings around them
    subroutine extend_from_ring(members)
      integer, intent(inout) :: members
      integer, allocatable :: around(:)
      integer :: i
      call ring_of_patch(around)
      do i = 1, size(around)
        call take_in(around(i), members)
      end do
      call add_in_reach_of([(i, i=patches%first(p), patches%first(p + 1) - 1), around], members)
      call add_rings(members)
    end subroutine extend_from_ring

    !> One more element of the region, unless it is in
    subroutine take_in(e, members)
      integer, intent(in) :: e
      integer, intent(inout) :: members
      if (stamp_element(e) == p) return
      stamp_element(e) = p
      members = members + 1
      region(members) = e
    end subroutine take_in

    !> Elements that share a node with one of the patch, without those of it
    subroutine ring_of_patch(around)
      integer, allocatable, intent(out) :: around(:)
      integer :: i, k, j, node, other, m
      walk = walk + 1
      m = 0
      do i = patches%first(p), patches%first(p + 1) - 1
        do k = 1, kind_corners(mesh%kind(i))
          node = mesh%node(k, i)
          do j = mesh%vertex_first(node), mesh%vertex_first(node + 1) - 1
            other = mesh%vertex_element(j)
            if (patches%of_element(other) == p .or. seen(other) == walk) cycle
            seen(other) = walk
            m = m + 1
            list(m) = other
          end do
        end do
      end do
      around = list(:m)
    end subroutine ring_of_patch

    !> Elements nearer to one of these than domains reach, found by going outwards over vertices; boxes stand for elements
    subroutine add_in_reach_of(sources, members)
      integer, intent(in) :: sources(:)
      integer, intent(inout) :: members
      real(wp) :: source_low(size(sources), mesh%dim), source_high(size(sources), mesh%dim)
      real(wp) :: group_low(mesh%dim, (size(sources) + at_once - 1)/at_once), group_high(mesh%dim, (size(sources) + at_once - 1)/at_once)
      integer :: i, k, j, node, other
      if (.not. reach > 0.0_wp) return
      source_low = transpose(low(:, sources))
      source_high = transpose(high(:, sources))
      do i = 1, size(group_low, 2)
        associate (first => at_once*(i - 1) + 1, last => min(at_once*i, size(sources)))
          group_low(:, i) = minval(source_low(first:last, :), dim=1)
          group_high(:, i) = maxval(source_high(first:last, :), dim=1)
        end associate
      end do
      walk = walk + 1
      i = 1
      do while (i <= members)
        do k = 1, kind_corners(mesh%kind(region(i)))
          node = mesh%node(k, region(i))
          do j = mesh%vertex_first(node), mesh%vertex_first(node + 1) - 1
            other = mesh%vertex_element(j)
            if (seen(other) == walk .or. stamp_element(other) == p) cycle
            seen(other) = walk
            if (is_near(size(sources), source_low, source_high, group_low, group_high, low(:, other), high(:, other), (reach*patches%width(p))**2)) &
              call take_in(other, members)
          end do
        end do
        i = i + 1
      end do
    end subroutine add_in_reach_of

    !> Elements that share a node with those of the region, as often as rings are wanted
    subroutine add_rings(members)
      integer, intent(inout) :: members
      integer :: ring, i, k, j, node, last
      do ring = 1, rings
        last = members
        do i = 1, last
          do k = 1, kind_corners(mesh%kind(region(i)))
            node = mesh%node(k, region(i))
            do j = mesh%vertex_first(node), mesh%vertex_first(node + 1) - 1
              call take_in(mesh%vertex_element(j), members)
            end do
          end do
        end do
      end do
    end subroutine add_rings

  end subroutine make_pads

  !> Whether a box is nearer than a distance to one of several; boxes around 16 of them each decide most
  pure logical function is_near(n, lows, highs, group_low, group_high, low, high, squared)
    integer, intent(in) :: n
    real(wp), intent(in) :: lows(:, :), highs(:, :) !! (box, axis)
    real(wp), intent(in) :: group_low(:, :), group_high(:, :) !! (axis, group)
    real(wp), intent(in) :: low(:), high(:), squared
    real(wp) :: far(at_once)
    integer :: group, first, m, k, i
    is_near = .true.
    do group = 1, size(group_low, 2)
      if (sum(max(0.0_wp, low - group_high(:, group), group_low(:, group) - high)**2) >= squared) cycle
      first = at_once*(group - 1)
      m = min(at_once, n - first)
      far = huge(1.0_wp)
      far(:m) = 0.0_wp
      do k = 1, size(low)
        do i = 1, m
          far(i) = far(i) + max(0.0_wp, low(k) - highs(first + i, k), lows(first + i, k) - high(k))**2
        end do
      end do
      if (any(far < squared)) return
    end do
    is_near = .false.
  end function is_near

  !> Sizes of the elements of all patches
  subroutine measure(mesh, patches)
    type(mesh_t), intent(in) :: mesh
    type(patches_t), intent(inout) :: patches
    real(wp), allocatable :: height(:), volume(:), around(:) ! around: a node, least height of its elements
    real(wp) :: factor
    integer :: e, i, k, p
    allocate (height(mesh%elements), volume(mesh%elements), around(mesh%nodes), patches%height(patches%n), patches%width(patches%n))
    !$omp parallel do schedule(static) private(factor, i)
    do e = 1, mesh%elements
      associate (kind => mesh%kind(e))
        factor = 1.0_wp
        if (kind_corners(kind) == mesh%dim + 1) factor = product([(i, i=1, mesh%dim)]) ! simplices: of the cell they are parts of
        volume(e) = factor*element_volume(kind, mesh%x(:, mesh%node(:kind_nodes(kind), e)))
        height(e) = element_height(kind, mesh%x(:, mesh%node(:kind_nodes(kind), e)))
      end associate
    end do
    !$omp end parallel do
    around = huge(1.0_wp)
    do e = 1, mesh%elements
      do k = 1, kind_corners(mesh%kind(e))
        around(mesh%node(k, e)) = min(around(mesh%node(k, e)), height(e))
      end do
    end do
    do p = 1, patches%n
      associate (first => patches%first(p), last => patches%first(p + 1) - 1)
        patches%width(p) = (sum(volume(first:last))/(last - first + 1))**(1.0_wp/mesh%dim)
        patches%height(p) = huge(1.0_wp)
        do e = first, last
          patches%height(p) = min(patches%height(p), minval(around(mesh%node(:kind_corners(mesh%kind(e)), e))))
        end do
      end associate
    end do
  end subroutine measure

  !> Slots of every pad, pads of every slot, and which node of a pad is which node of a slot
  subroutine find_slots(patches)
    type(patches_t), intent(inout) :: patches
    integer :: here(0:patches%slots - 1), count(0:patches%slots), gives(0:patches%slots)
    integer, allocatable :: list(:)
    integer :: p, i, s, n, m
    allocate (patches%near_first(patches%n + 1), patches%pad_near(size(patches%pad_node)), list(0))
    allocate (patches%near(64))
    here = 0
    count = 0
    gives = 0
    n = 0
    do p = 1, patches%n
      patches%near_first(p) = n + 1
      list = distinct(slot_of(patches%pad_node(patches%pad_first(p):patches%pad_first(p + 1) - 1)))
      m = size(list)
      do while (n + m > size(patches%near))
        patches%near = [patches%near, patches%near]
      end do
      patches%near(n + 1:n + m) = list
      here(list) = [(i, i=1, m)]
      count(list) = count(list) + 1
      do i = patches%pad_first(p), patches%pad_first(p + 1) - 1
        s = slot_of(patches%pad_node(i))
        patches%pad_near(i) = here(s)
        gives(s) = gives(s) + 1
      end do
      n = n + m
      patches%most_near = max(patches%most_near, m)
    end do
    patches%near_first(patches%n + 1) = n + 1
    patches%near = patches%near(:n)
    patches%most_touch = maxval(count)
    call starts_of(count, patches%touch_first)
    call starts_of(gives, patches%give_first)
    allocate (patches%touch(n), patches%give_touch(size(patches%pad_node)), patches%give_pad(size(patches%pad_node)), &
              patches%give_place(size(patches%pad_node)))
    count = 0
    gives = 0
    do p = 1, patches%n ! so that all lists are in the order of patches
      do i = patches%near_first(p), patches%near_first(p + 1) - 1
        s = patches%near(i)
        patches%touch(patches%touch_first(s + 1) + count(s)) = p
        count(s) = count(s) + 1
      end do
      do i = patches%pad_first(p), patches%pad_first(p + 1) - 1
        s = slot_of(patches%pad_node(i))
        m = patches%give_first(s + 1) + gives(s)
        patches%give_touch(m) = count(s)
        patches%give_pad(m) = i + 1 - patches%pad_first(p)
        patches%give_place(m) = place_of(patches%pad_node(i))
        gives(s) = gives(s) + 1
      end do
    end do
  end subroutine find_slots

  !> Where each of several lists begins when they stand one after the other
  pure subroutine starts_of(count, first)
    integer, intent(in) :: count(0:)
    integer, allocatable, intent(out) :: first(:)
    integer :: k
    allocate (first(size(count)))
    first(1) = 1
    do k = 2, size(count)
      first(k) = first(k - 1) + count(k - 2)
    end do
  end subroutine starts_of

  function distinct(list) result(sorted)
    integer, intent(in) :: list(:)
    integer, allocatable :: sorted(:)
    integer, allocatable :: order(:)
    integer :: i, n
    call sort_order(int(list, i8), order)
    allocate (sorted(size(list)))
    n = 0
    do i = 1, size(list)
      if (n > 0) then
        if (sorted(n) == list(order(i))) cycle
      end if
      n = n + 1
      sorted(n) = list(order(i))
    end do
    sorted = sorted(:n)
  end function distinct

end module gimp_patches
