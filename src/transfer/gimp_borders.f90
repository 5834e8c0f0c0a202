!> The tables of active blocks of a rank, with the blocks of other ranks that reach its nodes (ghosts), and the exchange of their pads.
!>
!> Every rank works out all nodes that its particles can touch. Where blocks of several ranks give to a node, each of these ranks gets the
!> pads of the others and adds them in the same order as a serial run does: same bits, one message each way, and no
!> answer to wait for. Sums over nodes count a slot on one rank only (`booked`).
module gimp_borders
  use gimp_kinds, only: wp, i8
  use gimp_grid, only: block_key, has_images, nf => fields_per_node
  use gimp_blocks, only: build_blocks, block_with_key
  use gimp_mesh_blocks, only: build_mesh_blocks
  use gimp_images, only: images_wanted, build_images, related_blocks
  use gimp_hash_table, only: find_key
  use gimp_sorting, only: rank_keys, sort_order
  use gimp_storage, only: real_bytes
  use gimp_ranks, only: ranks, exchange_words, open_channel, close_channel, start_exchange, finish_exchange
  use gimp_border, only: parts_t
  use gimp_ghosts, only: reach, find_ghosts, add_related, book_slots, near_images
  use gimp_engine, only: engine_t, spill_t, pad_edge, drift, make_room, order_blocks
  use, intrinsic :: iso_c_binding, only: c_loc, c_f_pointer
  implicit none(type, external)
  private
  public :: build_tables, send_pads, receive_pads, exchange_entries, widen_border

  integer, parameter :: few_parts = 32 !! not worth waking other threads for
  integer, parameter :: entry_words = 3 + nf !! of what goes beyond pads: slot, block, place, values

contains

  !> Tables of the blocks of this rank at `block_at`, in ascending order of keys. Collective
  subroutine build_tables(engine, block_at)
    type(engine_t), intent(inout) :: engine
    integer, intent(in) :: block_at(:, :) !! (3, block)
    integer, allocatable :: extra(:, :), ghost_at(:, :)
    if (engine%grid%is_mesh) then
      call build_tables_of_mesh(engine, block_at)
      return
    end if
    call images_wanted(engine%grid, block_at, extra)
    if (ranks == 1) then
      call build_blocks(engine%table, engine%grid, block_at, extra)
      call build_images(engine%grid, engine%table, engine%images)
      return
    end if
    call find_ghosts(engine%grid, engine%patches, engine%border, block_at, ghost_at)
    call add_related(engine%grid, engine%border, block_at, extra)
    call build_blocks(engine%table, engine%grid, block_at, extra, ghost_at)
    call build_images(engine%grid, engine%table, engine%images)
    call book_slots(engine%grid, engine%table)
    call lay_channel(engine, engine%border%always_whole)
  end subroutine build_tables

  !> The same of the patches of a mesh, which has no images
  subroutine build_tables_of_mesh(engine, block_at)
    type(engine_t), intent(inout) :: engine
    integer, intent(in) :: block_at(:, :) !! (3, block)
    integer, allocatable :: ghost_at(:, :)
    if (.not. allocated(engine%images)) allocate (engine%images(0))
    if (ranks == 1) then
      call build_mesh_blocks(engine%table, engine%patches, block_at)
      return
    end if
    call find_ghosts(engine%grid, engine%patches, engine%border, block_at, ghost_at)
    call build_mesh_blocks(engine%table, engine%patches, block_at, ghost_at)
    call book_slots(engine%grid, engine%table)
    call lay_channel(engine, engine%border%always_whole)
  end subroutine build_tables_of_mesh

  ! ------------------------------------------------------------------------------------------------ pads

  !> Ask for the parts of ghosts' pads that matter here, and hear what others ask for. Collective
  subroutine lay_channel(engine, whole)
    type(engine_t), intent(inout) :: engine
    logical, intent(in) :: whole !! all nodes of slots near blocks of this rank are wanted complete
    integer(i8) :: to_count(0:ranks - 1), from_count(0:ranks - 1)
    integer(i8), allocatable :: asked(:), heard(:)
    logical, allocatable :: complete(:)
    type(parts_t) :: get, give
    integer :: g, n, low(3), high(3)
    associate (table => engine%table, border => engine%border)
      border%whole = whole
      call find_complete(engine, whole, complete)
      allocate (get%block(table%ghosts), get%low(3, table%ghosts), get%high(3, table%ghosts), asked(2*table%ghosts))
      to_count = 0
      n = 0
      do g = 1, table%ghosts
        call part_wanted(engine, complete, table%blocks + g, low, high)
        if (any(low > high)) cycle
        n = n + 1
        get%block(n) = table%blocks + g
        get%low(:, n) = low
        get%high(:, n) = high
        asked(2*n - 1) = table%block_code(table%blocks + g)
        asked(2*n) = merge(packed_run(low, high), packed(low, high), engine%grid%is_mesh)
        to_count(border%ghost_rank(g)) = to_count(border%ghost_rank(g)) + 2
      end do
      get%block = get%block(:n)
      get%low = get%low(:, :n)
      get%high = get%high(:, :n)
      asked = asked(:2*n)
      call exchange_words(to_count, asked, from_count, heard)
      n = size(heard)/2
      allocate (give%block(n), give%low(3, n), give%high(3, n))
      do g = 1, n
        give%block(g) = block_with_key(table, heard(2*g - 1))
        if (engine%grid%is_mesh) then
          call unpack_run(heard(2*g), give%low(:, g), give%high(:, g))
        else
          call unpack_box(heard(2*g), give%low(:, g), give%high(:, g))
        end if
      end do
      call close_channel(border%channel)
      call cut_messages(to_count/2, get, border%channel%from, border%channel%from_first)
      call cut_messages(from_count/2, give, border%channel%to, border%channel%to_first)
      call open_channel(border%channel)
      border%give = give
      border%get = get
    end associate
  end subroutine lay_channel

  !> Slots of which every node must be right here: those that this rank books, and those of images; on request all near its blocks
  subroutine find_complete(engine, whole, complete)
    type(engine_t), intent(in) :: engine
    logical, intent(in) :: whole
    logical, allocatable, intent(out) :: complete(:)
    integer :: s
    associate (table => engine%table)
      complete = table%booked
      do s = 1, table%slots
        if (whole) complete(s) = complete(s) .or. any(table%block_near(:, s) > 0 .and. table%block_near(:, s) <= table%blocks)
        if (has_images(engine%grid)) complete(s) = complete(s) .or. near_images(engine%grid, table%slot_at(:, s))
      end do
    end associate
  end subroutine find_complete

  !> The box of nodes of a ghost's pad that matter here, from the first node of its block
  subroutine part_wanted(engine, complete, ghost, low, high)
    type(engine_t), intent(in) :: engine
    logical, intent(in) :: complete(:)
    integer, intent(in) :: ghost
    integer, intent(out) :: low(3), high(3)
    integer :: pad_low(3), pad_high(3), off(3), s, x, y, z, step(3)
    if (engine%grid%is_mesh) then
      call nodes_wanted(engine, ghost, low, high)
      return
    end if
    step = merge(reach, 0, [1, 2, 3] <= engine%grid%dim)
    call pad_box(engine, pad_low, pad_high)
    low = huge(low)
    high = -huge(high)
    associate (table => engine%table, edge => engine%grid%edge)
      do z = -step(3), step(3)
        do y = -step(2), step(2)
          do x = -step(1), step(1)
            off = [x, y, z]
            s = find_key(table%slot_of, block_key(table%block_at(:, ghost) + off))
            if (s == 0) cycle
            if (table%own_block(s) > 0) call unite(off*edge + pad_low, off*edge + pad_high)
            if (complete(s)) call unite(off*edge, off*edge + edge - 1)
          end do
        end do
      end do
    end associate

  contains

    !> Take a box of nodes in, as far as it is in the pad
    subroutine unite(first, last)
      integer, intent(in) :: first(3), last(3)
      if (any(max(first, pad_low) > min(last, pad_high))) return
      low = min(low, max(first, pad_low))
      high = max(high, min(last, pad_high))
    end subroutine unite

  end subroutine part_wanted

  !> The nodes of a patch's pad that are in slots of this rank, from the first to the last of them; nodes count from 0
  subroutine nodes_wanted(engine, ghost, low, high)
    type(engine_t), intent(in) :: engine
    integer, intent(in) :: ghost
    integer, intent(out) :: low(3), high(3)
    integer :: patch, k, i
    low = 0
    high = 0
    high(1) = -1
    patch = engine%table%block_at(1, ghost)
    associate (patches => engine%patches)
      do i = patches%pad_first(patch), patches%pad_first(patch + 1) - 1
        k = patches%near(patches%near_first(patch) + patches%pad_near(i) - 1)
        if (find_key(engine%table%slot_of, block_key([k, 0, 0])) == 0) cycle
        if (high(1) < 0) low(1) = i - patches%pad_first(patch)
        high(1) = i - patches%pad_first(patch)
      end do
    end associate
  end subroutine nodes_wanted

  !> First and last node of a pad, from the first node of its block
  pure subroutine pad_box(engine, low, high)
    type(engine_t), intent(in) :: engine
    integer, intent(out) :: low(3), high(3)
    low = merge(-drift, 0, [1, 2, 3] <= engine%grid%dim)
    high = low + pad_edge(engine%grid%dim, engine%basis) - 1
  end subroutine pad_box

  !> A box in one word
  pure integer(i8) function packed(low, high)
    integer, intent(in) :: low(3), high(3)
    integer :: k
    packed = 0
    do k = 1, 3
      packed = shiftl(packed, 16) + shiftl(int(low(k) + 8, i8), 8) + high(k) + 8
    end do
  end function packed

  pure subroutine unpack_box(word, low, high)
    integer(i8), intent(in) :: word
    integer, intent(out) :: low(3), high(3)
    integer :: k
    do k = 1, 3
      low(k) = int(ibits(word, 16*(3 - k) + 8, 8)) - 8
      high(k) = int(ibits(word, 16*(3 - k), 8)) - 8
    end do
  end subroutine unpack_box

  !> The same of consecutive nodes of a patch's pad
  pure integer(i8) function packed_run(low, high)
    integer, intent(in) :: low(3), high(3)
    packed_run = shiftl(int(low(1), i8), 32) + high(1)
  end function packed_run

  pure subroutine unpack_run(word, low, high)
    integer(i8), intent(in) :: word
    integer, intent(out) :: low(3), high(3)
    low = [int(shiftr(word, 32)), 0, 0]
    high = [int(iand(word, int(z"FFFFFFFF", i8))), 0, 0]
  end subroutine unpack_run

  !> Messages: the parts of each rank, and the words they need at most: one for each part, then its nodes
  subroutine cut_messages(parts_of_rank, parts, list, first_word)
    integer(i8), intent(in) :: parts_of_rank(0:)
    type(parts_t), intent(inout) :: parts
    integer, allocatable, intent(out) :: list(:)
    integer(i8), allocatable, intent(out) :: first_word(:)
    integer :: r, k, q
    list = pack([(r, r=0, ranks - 1)], parts_of_rank > 0)
    allocate (first_word(size(list) + 1), parts%first(size(list) + 1))
    parts%first(1) = 1
    first_word(1) = 1
    do k = 1, size(list)
      parts%first(k + 1) = parts%first(k) + int(parts_of_rank(list(k)))
      first_word(k + 1) = first_word(k) + parts_of_rank(list(k))
      do q = parts%first(k), parts%first(k + 1) - 1
        first_word(k + 1) = first_word(k + 1) + node_words(product(parts%high(:, q) - parts%low(:, q) + 1))
      end do
    end do
  end subroutine cut_messages

  !> Words that so many nodes take
  pure integer(i8) function node_words(nodes)
    integer, intent(in) :: nodes
    node_words = real_bytes*nf/8*nodes
  end function node_words

  !> Pads of blocks at the border set out for the ranks that want them. Collective
  subroutine send_pads(engine, all_of_them)
    type(engine_t), intent(inout) :: engine
    logical, intent(in) :: all_of_them !! the outermost nodes of pads are in use, whatever `drifted` says
    if (ranks == 1) return
    call pack_pads(engine, all_of_them)
    call start_exchange(engine%border%channel)
  end subroutine send_pads

  !> Ghosts get their pads. Collective
  subroutine receive_pads(engine)
    type(engine_t), intent(inout) :: engine
    if (ranks == 1) return
    call finish_exchange(engine%border%channel)
    call unpack_pads(engine)
  end subroutine receive_pads

  !> The part of a pad that is in use: without drift its outermost nodes are not
  pure subroutine shrink(engine, drifted, block, low, high)
    type(engine_t), intent(in) :: engine
    logical, intent(in) :: drifted
    integer, intent(in) :: block
    integer, intent(inout) :: low(3), high(3)
    integer :: pad_low(3), pad_high(3), d
    if (drifted) return
    if (engine%grid%is_mesh) then
      high(1) = min(high(1), engine%patches%inner(engine%table%block_at(1, block)) - 1)
      return
    end if
    d = engine%grid%dim
    call pad_box(engine, pad_low, pad_high)
    low(:d) = max(low(:d), pad_low(:d) + 1)
    high(:d) = min(high(:d), pad_high(:d) - 1)
  end subroutine shrink

  !> Fill the messages: of each part whether the outermost nodes of its pad are in use, then its nodes
  subroutine pack_pads(engine, all_of_them)
    type(engine_t), intent(inout) :: engine
    logical, intent(in) :: all_of_them
    integer(i8) :: at(size(engine%border%give%block)), word ! at: where each part begins
    logical :: drifted
    integer :: k, q
    associate (channel => engine%border%channel, give => engine%border%give)
      do k = 1, size(channel%to)
        word = channel%to_first(k)
        do q = give%first(k), give%first(k + 1) - 1
          at(q) = word
          drifted = engine%drifted(give%block(q)) .or. all_of_them
          channel%out(word) = merge(1_i8, 0_i8, drifted)
          word = word + 1 + part_words(engine, drifted, give%block(q), give%low(:, q), give%high(:, q))
        end do
        channel%to_words(k) = word - channel%to_first(k)
      end do
      !$omp parallel do schedule(static) if(size(at) > few_parts)
      do q = 1, size(at)
        call move_part(engine, channel%out(at(q)) == 1, give%low(:, q), give%high(:, q), give%block(q), channel%out, at(q) + 1, .true.)
      end do
      !$omp end parallel do
    end associate
  end subroutine pack_pads

  !> Take the messages apart
  subroutine unpack_pads(engine)
    type(engine_t), intent(inout) :: engine
    integer(i8) :: at(size(engine%border%get%block)), word
    integer :: k, q
    associate (channel => engine%border%channel, get => engine%border%get)
      do k = 1, size(channel%from)
        word = channel%from_first(k)
        do q = get%first(k), get%first(k + 1) - 1
          at(q) = word
          engine%drifted(get%block(q)) = channel%in(word) == 1
          word = word + 1 + part_words(engine, channel%in(word) == 1, get%block(q), get%low(:, q), get%high(:, q))
        end do
      end do
      !$omp parallel do schedule(static) if(size(at) > few_parts)
      do q = 1, size(at)
        call move_part(engine, channel%in(at(q)) == 1, get%low(:, q), get%high(:, q), get%block(q), channel%in, at(q) + 1, .false.)
      end do
      !$omp end parallel do
    end associate
  end subroutine unpack_pads

  !> Words of the nodes of a part that are in use
  pure integer(i8) function part_words(engine, drifted, block, low, high)
    type(engine_t), intent(in) :: engine
    logical, intent(in) :: drifted
    integer, intent(in) :: block, low(3), high(3)
    integer :: first(3), last(3)
    first = low
    last = high
    call shrink(engine, drifted, block, first, last)
    part_words = node_words(product(max(0, last - first + 1)))
  end function part_words

  !> Nodes of a part from a pad into a message, or out of a message into a pad
  subroutine move_part(engine, drifted, low, high, block, words, at, pack)
    type(engine_t), intent(inout) :: engine
    logical, intent(in) :: drifted, pack
    integer, intent(in) :: low(3), high(3), block
    integer(i8), intent(inout), contiguous, target :: words(:) !! of all messages
    integer(i8), intent(in) :: at !! where its nodes begin there
    real(wp), pointer, contiguous :: nodes(:)
    integer :: first(3), last(3), edge(3), n
    first = low
    last = high
    call shrink(engine, drifted, block, first, last)
    n = product(max(0, last - first + 1))
    if (n == 0) return
    first = first + pad_shift(engine)
    last = last + pad_shift(engine)
    edge = pad_edge(engine%grid%dim, engine%basis)
    if (engine%grid%is_mesh) edge = [size(engine%pad, 2), 1, 1]
    call c_f_pointer(c_loc(words(at)), nodes, [nf*n])
    if (pack) then
      call take_part(edge, first, last, engine%pad(:, :, block), nodes)
    else
      call put_part(edge, first, last, nodes, engine%pad(:, :, block))
    end if
  end subroutine move_part

  !> From nodes counted from the first of a block to nodes counted from the first of its pad
  pure function pad_shift(engine) result(shift)
    type(engine_t), intent(in) :: engine
    integer :: shift(3)
    shift = merge(drift, 0, [1, 2, 3] <= engine%grid%dim .and. .not. engine%grid%is_mesh)
  end function pad_shift

  pure subroutine take_part(edge, low, high, pad, nodes)
    integer, intent(in) :: edge(3), low(3), high(3)
    real(wp), intent(in) :: pad(nf, 0:edge(1) - 1, 0:edge(2) - 1, 0:edge(3) - 1)
    real(wp), intent(out) :: nodes(nf, low(1):high(1), low(2):high(2), low(3):high(3))
    nodes = pad(:, low(1):high(1), low(2):high(2), low(3):high(3))
  end subroutine take_part

  pure subroutine put_part(edge, low, high, nodes, pad)
    integer, intent(in) :: edge(3), low(3), high(3)
    real(wp), intent(in) :: nodes(nf, low(1):high(1), low(2):high(2), low(3):high(3))
    real(wp), intent(inout) :: pad(nf, 0:edge(1) - 1, 0:edge(2) - 1, 0:edge(3) - 1)
    pad(:, low(1):high(1), low(2):high(2), low(3):high(3)) = nodes
  end subroutine put_part

  !> From now to the next sort all nodes near blocks of this rank are complete. Collective
  subroutine widen_border(engine)
    type(engine_t), intent(inout) :: engine
    if (ranks == 1 .or. engine%border%whole) return
    call lay_channel(engine, .true.)
    call order_blocks(engine)
  end subroutine widen_border

  ! ------------------------------------------------------------------------------------------------ what goes beyond pads

  !> Entries (block, slot, place, values) go to all ranks that know of the slot, and come back in the order of slots, then blocks,
  !> as a serial run has them; what one block gives to a slot stays in its order. Collective
  subroutine exchange_entries(engine, entries)
    type(engine_t), intent(in) :: engine
    type(spill_t), intent(inout) :: entries
    integer(i8) :: to_count(0:ranks - 1), from_count(0:ranks - 1)
    integer(i8), allocatable :: sent(:), heard(:), code(:), key(:)
    integer, allocatable :: to(:), which(:), order(:), rank(:)
    type(spill_t) :: all
    integer :: k, n, r, m, found, near(ranks), slot
    if (ranks == 1) return
    allocate (to(64), which(64))
    n = 0
    slot = 0
    do k = 1, entries%n
      if (entries%slot(k) /= slot) call holders(engine, entries%slot(k), near, found)
      slot = entries%slot(k)
      do r = 1, found
        if (n == size(to)) then
          to = [to, to]
          which = [which, which]
        end if
        n = n + 1
        to(n) = near(r)
        which(n) = k
      end do
    end do
    call sort_order(int(to(:n), i8), order)
    allocate (sent(int(entry_words, i8)*n))
    do k = 1, n
      call pack_entry(which(order(k)), sent(int(entry_words, i8)*(k - 1) + 1:int(entry_words, i8)*k))
    end do
    to_count = [(entry_words*count(to(:n) == r, kind=i8), r=0, ranks - 1)]
    call exchange_words(to_count, sent, from_count, heard)
    m = entries%n + size(heard)/entry_words
    call make_room(all, max(m, 64))
    allocate (code(m))
    do k = 1, entries%n
      all%block(k) = entries%block(k)
      all%slot(k) = entries%slot(k)
      all%place(k) = entries%place(k)
      all%value(:, k) = entries%value(:, k)
      code(k) = engine%table%block_code(entries%block(k))
    end do
    n = entries%n
    do k = 1, size(heard)/entry_words
      associate (word => heard(int(entry_words, i8)*(k - 1) + 1:int(entry_words, i8)*k))
        slot = find_key(engine%table%slot_of, word(1))
        if (slot == 0) cycle
        n = n + 1
        all%slot(n) = slot
        code(n) = word(2)
        all%block(n) = engine%table%blocks + find_key(engine%border%ghost_of, word(2))
        all%place(n) = int(word(3))
        all%value(:, n) = transfer(word(4:3 + int(node_words(1))), all%value(:, n), nf)
      end associate
    end do
    call rank_keys(code(:n), key, rank)
    call sort_order(shiftl(int(all%slot(:n), i8), 32) + rank, order)
    entries%n = 0
    call make_room(entries, n)
    entries%n = n
    do k = 1, n
      entries%block(k) = all%block(order(k))
      entries%slot(k) = all%slot(order(k))
      entries%place(k) = all%place(order(k))
      entries%value(:, k) = all%value(:, order(k))
    end do

  contains

    subroutine pack_entry(e, words)
      integer, intent(in) :: e
      integer(i8), intent(out) :: words(:)
      words(1) = block_key(engine%table%slot_at(:, entries%slot(e)))
      words(2) = engine%table%block_code(entries%block(e))
      words(3) = entries%place(e)
      words(4:) = 0
      words(4:3 + int(node_words(1))) = transfer(entries%value(:, e), words, int(node_words(1)))
    end subroutine pack_entry

  end subroutine exchange_entries

  !> Other ranks that have a slot near a block of this rank, or one that shares nodes with it
  subroutine holders(engine, slot, list, n)
    type(engine_t), intent(in) :: engine
    integer, intent(in) :: slot
    integer, intent(out) :: list(:), n
    integer, allocatable :: related(:, :)
    integer :: k, j, s
    n = 0
    if (near_images(engine%grid, engine%table%slot_at(:, slot))) then
      call related_blocks(engine%grid, engine%table%slot_at(:, slot), related)
      do j = 1, size(related, 2)
        s = find_key(engine%table%slot_of, block_key(related(:, j)))
        if (s > 0) call note_owners(s)
      end do
    else
      call note_owners(slot)
    end if

  contains

    subroutine note_owners(s)
      integer, intent(in) :: s
      integer :: r
      do k = 1, size(engine%table%block_near, 1)
        if (engine%table%block_near(k, s) <= engine%table%blocks) cycle
        r = engine%border%ghost_rank(engine%table%block_near(k, s) - engine%table%blocks)
        if (any(list(:n) == r)) cycle
        n = n + 1
        list(n) = r
      end do
    end subroutine note_owners

  end subroutine holders

end module gimp_borders
