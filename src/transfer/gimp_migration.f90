!> Particles and blocks that change their rank.
!>
!> At a sort every particle whose block another rank owns goes there, in one message to each such rank, with all that it stores
!> and the block its position refers to: the sort there does to it what a sort here would do. When the work of
!> ranks differs by more than a limit, whole blocks go over to the neighbours in stored order, so that all
!> ranks have about the same again; that changes no bit of the state.
module gimp_migration
  use gimp_kinds, only: wp, i8, lanes
  use gimp_grid, only: block_key, block_at_key
  use gimp_hash_table, only: hash_table_t, clear_table, insert_key, list_keys
  use gimp_sorting, only: sort_order
  use gimp_storage, only: real_bytes
  use gimp_particles, only: particles_t, group_t, allot_chunks
  use gimp_ranks, only: this_rank, ranks, exchange_words, sum_words, largest_words
  use gimp_cuts, only: find_cuts, rank_of_key, is_mine, work_of_ranks
  use gimp_border, only: border_t, repartition_always, repartition_never
  use gimp_homes, only: shift_chunk
  use gimp_ghosts, only: ranks_near_patch
  use gimp_engine, only: engine_t, work_of_pad
  use, intrinsic :: iso_c_binding, only: c_loc, c_f_pointer
  implicit none(type, external)
  private
  public :: migrate, balance

  integer, parameter :: try_again = 10 !! sorts after which cuts are looked for again that were not good enough
  integer, parameter :: head = 3 !! words before the fields of a particle: number, material, block

contains

  !> Particles at home on other ranks go there; `gone` marks all that are no longer here. Collective
  subroutine migrate(engine, gone)
    type(engine_t), intent(inout) :: engine
    logical, allocatable, intent(inout) :: gone(:, :) !! (lane, chunk) on entry particles that leave the run, if any do
    integer(i8) :: to_count(0:ranks - 1), from_count(0:ranks - 1)
    integer(i8), allocatable, target :: sent(:), heard(:)
    integer(i8), allocatable :: place(:)
    integer, allocatable :: to(:, :)
    integer :: size_of_one, r
    if (ranks == 1) return
    if (.not. allocated(engine%border%cut)) call first_cuts(engine)
    allocate (to(lanes, engine%particles%chunks), source=-1)
    call find_travellers(engine, gone, to)
    size_of_one = head + words_of(engine%particles%components)
    call count_travellers(to, to_count)
    to_count = size_of_one*to_count
    allocate (sent(sum(to_count)), place(0:ranks - 1))
    place(0) = 0
    do r = 1, ranks - 1
      place(r) = place(r - 1) + to_count(r - 1)
    end do
    call pack_travellers(engine%particles, to, size_of_one, place, sent)
    if (.not. allocated(gone)) allocate (gone(lanes, engine%particles%chunks), source=.false.)
    gone = gone .or. to >= 0
    call exchange_words(to_count, sent, from_count, heard)
    engine%border%migrated_words = engine%border%migrated_words + size(sent)
    engine%border%migrated = engine%border%migrated + size(sent)/size_of_one
    deallocate (sent)
    call settle(engine, size_of_one, heard, gone)
  end subroutine migrate

  !> Words that so many reals take
  pure integer function words_of(reals)
    integer, intent(in) :: reals
    words_of = (reals*int(real_bytes) + 7)/8
  end function words_of

  !> Cuts for particles that nobody has sorted yet
  subroutine first_cuts(engine)
    type(engine_t), intent(inout) :: engine
    type(hash_table_t) :: found
    integer(i8), allocatable :: keys(:), work(:), sorted(:), amount(:)
    integer(i8) :: key(lanes)
    integer, allocatable :: order(:)
    integer :: g, c, l, n, value
    call clear_table(found, 64)
    allocate (keys(64), work(64))
    n = 0
    do g = 1, size(engine%particles%groups)
      do c = engine%particles%groups(g)%first, engine%particles%groups(g)%last
        call keys_of_chunk(engine, g, c, key)
        do l = 1, lanes
          if (engine%particles%id(l, c) == 0) cycle
          call insert_key(found, key(l), n + 1, value)
          if (value > n) then
            if (n == size(keys)) then
              keys = [keys, keys]
              work = [work, work]
            end if
            n = n + 1
            keys(n) = key(l)
            work(n) = 0 ! not that of its pad: several ranks may know of the block
          end if
          work(value) = work(value) + 1
        end do
      end do
    end do
    call sort_order(keys(:n), order)
    sorted = keys(order)
    amount = work(order)
    allocate (engine%border%cut(0:ranks))
    call find_cuts(sorted, amount, engine%border%cut)
  end subroutine first_cuts

  !> Keys of the blocks that the lanes of a chunk are at home in
  subroutine keys_of_chunk(engine, g, c, key)
    type(engine_t), intent(in) :: engine
    integer, intent(in) :: g, c
    integer(i8), intent(out) :: key(lanes)
    real(wp) :: p(lanes, engine%particles%components)
    integer :: off(lanes, 3), cell(lanes), l
    off = 0
    p = engine%particles%p(:, :, c) ! positions stay as they are: the sort shifts them
    call shift_chunk(engine, engine%particles%groups(g)%at, engine%particles%components, p, off, cell)
    do l = 1, lanes
      key(l) = block_key(engine%particles%groups(g)%at + off(l, :))
    end do
  end subroutine keys_of_chunk

  !> The rank that each particle goes to; -1 for those that stay
  subroutine find_travellers(engine, gone, to)
    type(engine_t), intent(in) :: engine
    logical, allocatable, intent(in) :: gone(:, :)
    integer, intent(inout) :: to(:, :)
    integer(i8) :: key(lanes)
    integer :: g, c, l
    !$omp parallel do schedule(dynamic, 4) private(c, l, key)
    do g = 1, size(engine%particles%groups)
      if (all_stay(engine, engine%particles%groups(g)%at)) cycle
      do c = engine%particles%groups(g)%first, engine%particles%groups(g)%last
        call keys_of_chunk(engine, g, c, key)
        do l = 1, lanes
          if (engine%particles%id(l, c) == 0) cycle
          if (.not. is_mine(engine%border%cut, key(l))) to(l, c) = rank_of_key(engine%border%cut, key(l))
        end do
      end do
    end do
    !$omp end parallel do
    if (allocated(gone)) where (gone) to = -1
  end subroutine find_travellers

  !> How many go to each rank
  pure subroutine count_travellers(to, travellers)
    integer, intent(in) :: to(:, :)
    integer(i8), intent(out) :: travellers(0:) !! (rank)
    integer :: c, l
    travellers = 0
    do c = 1, size(to, 2)
      do l = 1, lanes
        if (to(l, c) >= 0) travellers(to(l, c)) = travellers(to(l, c)) + 1
      end do
    end do
  end subroutine count_travellers

  !> Whether all blocks around one are of this rank. No particle moves farther between two sorts: runs stop before.
  logical function all_stay(engine, at)
    type(engine_t), intent(in) :: engine
    integer, intent(in) :: at(3)
    integer :: step(3), near(ranks), n
    if (engine%grid%is_mesh) then
      all_stay = .false.
      if (at(1) == 0) return ! not sorted yet
      call ranks_near_patch(engine%patches, engine%border%cut, at(1), near, n)
      all_stay = n == 0 .and. is_mine(engine%border%cut, block_key(at))
      return
    end if
    step = merge(1, 0, [1, 2, 3] <= engine%grid%dim)
    all_stay = is_mine(engine%border%cut, block_key(at - step)) .and. is_mine(engine%border%cut, block_key(at + step))
    if (.not. all_stay .or. .not. any(engine%particles%groups%block > 0)) then
      all_stay = .false.
      return
    end if
    all_stay = .not. any(engine%grid%periodic .and. ((at - 1)*engine%grid%edge <= 0 .or. (at + 2)*engine%grid%edge >= engine%grid%cells))
  end function all_stay

  !> Numbers, materials, blocks and fields of the travellers
  subroutine pack_travellers(particles, to, size_of_one, place, sent)
    type(particles_t), intent(in) :: particles
    integer, intent(in) :: to(:, :), size_of_one
    integer(i8), intent(inout) :: place(0:) !! words packed before those for each rank
    integer(i8), intent(inout), target :: sent(:)
    real(wp), pointer :: fields(:)
    integer :: g, c, l
    do g = 1, size(particles%groups)
      do c = particles%groups(g)%first, particles%groups(g)%last
        do l = 1, lanes
          if (to(l, c) < 0) cycle
          associate (at => place(to(l, c)))
            sent(at + 1:at + head) = [particles%id(l, c), int(particles%groups(g)%material, i8), block_key(particles%groups(g)%at)]
            sent(at + size_of_one) = 0
            call c_f_pointer(c_loc(sent(at + head + 1)), fields, [particles%components])
            fields = particles%p(l, :, c)
            at = at + size_of_one
          end associate
        end do
      end do
    end do
  end subroutine pack_travellers

  !> New chunks at the end for particles that came, in groups of a block and a material
  subroutine settle(engine, size_of_one, heard, gone)
    type(engine_t), intent(inout) :: engine
    integer, intent(in) :: size_of_one
    integer(i8), intent(in), target :: heard(:)
    logical, allocatable, intent(inout) :: gone(:, :)
    real(wp), pointer :: fields(:)
    type(group_t), allocatable :: more(:)
    logical, allocatable :: wider(:, :)
    integer, allocatable :: order(:), again(:)
    integer(i8) :: at, before(2), this(2)
    integer :: n, k, groups, chunks, lane, old
    n = size(heard)/size_of_one
    if (n == 0) return
    call sort_order([(heard(int(size_of_one, i8)*(k - 1) + 2), k=1, n)], order) ! by material, then by block: both sorts are stable
    call sort_order([(heard(int(size_of_one, i8)*(order(k) - 1) + 3), k=1, n)], again)
    order = order(again)
    old = engine%particles%chunks
    call count_chunks()
    call allot_chunks(engine%particles, old + chunks)
    allocate (wider(lanes, old + chunks), source=.false.)
    wider(:, :old) = gone
    call move_alloc(wider, gone)
    allocate (more(groups))
    groups = 0
    chunks = old
    before = -1
    lane = lanes
    do k = 1, n
      at = int(size_of_one, i8)*(order(k) - 1)
      this = heard(at + 2:at + 3)
      if (any(this /= before)) then
        groups = groups + 1
        more(groups) = group_t(0, int(this(1)), chunks + 1, chunks, block_at_key(this(2)))
        lane = lanes
      end if
      before = this
      if (lane == lanes) then
        chunks = chunks + 1
        more(groups)%last = chunks
        engine%particles%p(:, :, chunks) = 0.0_wp
        engine%particles%id(:, chunks) = 0
        lane = 0
      end if
      lane = lane + 1
      engine%particles%id(lane, chunks) = heard(at + 1)
      call c_f_pointer(c_loc(heard(at + head + 1)), fields, [engine%particles%components])
      engine%particles%p(lane, :, chunks) = fields
    end do
    engine%particles%groups = [engine%particles%groups, more]

  contains

    subroutine count_chunks()
      integer :: in_group
      groups = 0
      chunks = 0
      in_group = 0
      before = -1
      do k = 1, n
        at = int(size_of_one, i8)*(order(k) - 1)
        if (any(heard(at + 2:at + 3) /= before)) then
          groups = groups + 1
          in_group = 0
        end if
        before = heard(at + 2:at + 3)
        if (modulo(in_group, lanes) == 0) chunks = chunks + 1
        in_group = in_group + 1
      end do
    end subroutine count_chunks

  end subroutine settle

  ! ------------------------------------------------------------------------------------------------ balance

  !> Hand blocks over when the work of ranks differs too much. Particles are sorted, tables not yet made. Collective
  subroutine balance(engine, block_at)
    type(engine_t), intent(inout) :: engine
    integer, allocatable, intent(inout) :: block_at(:, :) !! (3, block)
    integer(i8) :: work(size(block_at, 2)), key(size(block_at, 2)), cut(0:ranks), shares(0:ranks - 1)
    real :: now(2), after
    integer :: b
    if (ranks == 1) return
    associate (border => engine%border, particles => engine%particles)
      border%sorts = border%sorts + 1
      do b = 1, size(work)
        key(b) = block_key(block_at(:, b))
        work(b) = work_of_pad + particles%groups(particles%block_group(b + 1) - 1)%last &
                  - particles%groups(particles%block_group(b))%first + 1
      end do
      now = imbalance_of([sum(work), particles%n])
      if (border%repartition == repartition_always) then
        call find_cuts(key, work*chance_weight(key, border%sorts), cut)
        call hand_over(engine, block_at, key, cut)
        now = imbalance_of([sum(work_here(engine)), particles%n])
      else if (worth_a_try(border, now(1))) then
        call find_cuts(key, work, cut)
        call work_of_ranks(key, work, cut, shares)
        after = real(maxval(shares)*ranks)/max(1.0, real(sum(shares)))
        border%best = after
        border%tried = border%sorts
        if (is_worth_it(now(1), after)) then
          call hand_over(engine, block_at, key, cut)
          now = imbalance_of([sum(work_here(engine)), particles%n])
        end if
      end if
      border%imbalance = now(1)
      border%worst_imbalance = max(border%worst_imbalance, now(1))
      border%crowding = now(2)
      border%worst_crowding = max(border%worst_crowding, now(2))
    end associate
  end subroutine balance

  !> Weights from 1 to 16 without a pattern, other ones at each sort
  pure elemental integer(i8) function chance_weight(key, sorts) result(weight)
    integer(i8), intent(in) :: key, sorts
    weight = 1 + modulo((1 + modulo(key, 2_i8**24))*(2*modulo(sorts, 2_i8**16) + 1)*40503/2**7, 16_i8)
  end function chance_weight

  !> Whether cuts are to be looked for. Where blocks are few and cannot lie more evenly that is not done at every sort
  pure logical function worth_a_try(border, now)
    type(border_t), intent(in) :: border
    real, intent(in) :: now !! imbalance
    worth_a_try = border%repartition /= repartition_never .and. now > border%most_imbalance
    if (border%tried > 0) worth_a_try = worth_a_try .and. (is_worth_it(now, border%best) .or. border%sorts >= border%tried + try_again)
  end function worth_a_try

  !> Whether a better balance is worth its messages: it must halve the imbalance
  pure logical function is_worth_it(now, after)
    real, intent(in) :: now, after
    is_worth_it = after < 0.5*(now + 1.0)
  end function is_worth_it

  !> Largest amounts of a rank over their means. Collective
  function imbalance_of(amount) result(imbalance)
    integer(i8), intent(in) :: amount(:)
    real :: imbalance(size(amount))
    integer(i8) :: most(size(amount)), all_of_it(size(amount))
    most = amount
    all_of_it = amount
    call largest_words(most)
    call sum_words(all_of_it)
    imbalance = real(most)*ranks/max(1.0, real(all_of_it))
  end function imbalance_of

  !> Counted work of this rank, by blocks
  pure function work_here(engine) result(work)
    type(engine_t), intent(in) :: engine
    integer(i8) :: work(size(engine%particles%block_group) - 1)
    integer :: b
    do b = 1, size(work)
      work(b) = work_of_pad + engine%particles%groups(engine%particles%block_group(b + 1) - 1)%last &
                - engine%particles%groups(engine%particles%block_group(b))%first + 1
    end do
  end function work_here

  !> Blocks go to the owners that new cuts name. Both lists are in the order of keys: what comes from lower ranks comes before the
  !> blocks that stay, what comes from higher ranks after them. Collective
  subroutine hand_over(engine, block_at, key, cut)
    type(engine_t), intent(inout) :: engine
    integer, allocatable, intent(inout) :: block_at(:, :)
    integer(i8), intent(in) :: key(:), cut(0:)
    integer(i8) :: to_count(0:ranks - 1), from_count(0:ranks - 1)
    integer(i8), allocatable, target :: sent(:), heard(:)
    integer :: owner(size(key)), b, first, last
    do b = 1, size(key)
      owner(b) = rank_of_key(cut, key(b))
    end do
    call pack_blocks(engine%particles, owner, key, to_count, sent)
    engine%border%repartitions = engine%border%repartitions + 1
    engine%border%moved_words = engine%border%moved_words + size(sent)
    call exchange_words(to_count, sent, from_count, heard)
    deallocate (sent)
    first = findloc(owner, this_rank, dim=1)
    last = findloc(owner, this_rank, dim=1, back=.true.)
    if (first == 0) first = 1
    call take_over(engine, block_at, first, last, sum(from_count(:this_rank - 1)), heard)
    engine%border%cut = cut
  end subroutine hand_over

  !> Blocks that leave: key and groups; of each group material and chunks; then numbers and fields of its chunks as they are
  subroutine pack_blocks(particles, owner, key, to_count, sent)
    type(particles_t), intent(in) :: particles
    integer, intent(in) :: owner(:)
    integer(i8), intent(in) :: key(:)
    integer(i8), intent(out) :: to_count(0:)
    integer(i8), allocatable, target, intent(out) :: sent(:)
    real(wp), pointer, contiguous :: fields(:, :)
    integer(i8) :: at
    integer :: b, g, c
    to_count = 0
    do b = 1, size(key)
      if (owner(b) /= this_rank) to_count(owner(b)) = to_count(owner(b)) + block_words(particles, b)
    end do
    allocate (sent(sum(to_count)))
    at = 0
    do b = 1, size(key) ! owners ascend with the keys
      if (owner(b) == this_rank) cycle
      sent(at + 1:at + 2) = [key(b), int(particles%block_group(b + 1) - particles%block_group(b), i8)]
      at = at + 2
      do g = particles%block_group(b), particles%block_group(b + 1) - 1
        sent(at + 1:at + 2) = [particles%groups(g)%material, particles%groups(g)%last - particles%groups(g)%first + 1]
        at = at + 2
        do c = particles%groups(g)%first, particles%groups(g)%last
          sent(at + 1:at + lanes) = particles%id(:, c)
          at = at + lanes
          call c_f_pointer(c_loc(sent(at + 1)), fields, [lanes, particles%components])
          fields = particles%p(:, :, c)
          at = at + words_of(lanes*particles%components)
        end do
      end do
    end do
  end subroutine pack_blocks

  !> Words of a block in a message
  pure integer(i8) function block_words(particles, b) result(words)
    type(particles_t), intent(in) :: particles
    integer, intent(in) :: b
    integer :: first, last
    first = particles%block_group(b)
    last = particles%block_group(b + 1) - 1
    words = 2 + 2*(last - first + 1) + int(particles%groups(last)%last - particles%groups(first)%first + 1, i8) &
            *(lanes + words_of(lanes*particles%components))
  end function block_words

  !> The blocks that stay, and before and after them those that came
  subroutine take_over(engine, block_at, first, last, words_before, heard)
    type(engine_t), intent(inout) :: engine
    integer, allocatable, intent(inout) :: block_at(:, :)
    integer, intent(in) :: first, last !! blocks that stay
    integer(i8), intent(in) :: words_before !! of what comes before them
    integer(i8), intent(in), target :: heard(:)
    type(group_t), allocatable :: kept(:), groups(:)
    integer, allocatable :: at_kept(:, :)
    integer :: chunks(2), blocks(2), in_groups(2), staying, shift, first_chunk, c
    associate (particles => engine%particles)
      staying = 0
      first_chunk = 1
      allocate (kept(0))
      if (last >= first) then
        kept = particles%groups(particles%block_group(first):particles%block_group(last + 1) - 1)
        first_chunk = kept(1)%first
        staying = kept(size(kept))%last - first_chunk + 1
      end if
      at_kept = block_at(:, first:last)
      call count_heard(particles%components, heard(:words_before), blocks(1), in_groups(1), chunks(1))
      call count_heard(particles%components, heard(words_before + 1:), blocks(2), in_groups(2), chunks(2))
      shift = chunks(1) + 1 - first_chunk
      call allot_chunks(particles, max(particles%chunks, chunks(1) + staying + chunks(2)))
      if (shift > 0) then
        do c = first_chunk + staying - 1, first_chunk, -1
          call move_chunk(particles, c, c + shift)
        end do
      else if (shift < 0) then
        do c = first_chunk, first_chunk + staying - 1
          call move_chunk(particles, c, c + shift)
        end do
      end if
      kept%first = kept%first + shift
      kept%last = kept%last + shift
      deallocate (block_at)
      allocate (block_at(3, blocks(1) + size(at_kept, 2) + blocks(2)), groups(in_groups(1) + size(kept) + in_groups(2)))
      call unpack_blocks(particles, heard(:words_before), block_at(:, :blocks(1)), groups(:in_groups(1)), 0)
      block_at(:, blocks(1) + 1:blocks(1) + size(at_kept, 2)) = at_kept
      groups(in_groups(1) + 1:in_groups(1) + size(kept)) = kept
      call unpack_blocks(particles, heard(words_before + 1:), block_at(:, blocks(1) + size(at_kept, 2) + 1:), &
                         groups(in_groups(1) + size(kept) + 1:), chunks(1) + staying)
      call allot_chunks(particles, chunks(1) + staying + chunks(2))
      call move_alloc(groups, particles%groups)
      call number_groups(particles)
      particles%n = count(particles%id > 0, kind=i8)
    end associate
  end subroutine take_over

  subroutine move_chunk(particles, from, to)
    type(particles_t), intent(inout) :: particles
    integer, intent(in) :: from, to
    integer :: k
    do k = 1, particles%components
      particles%p(:, k, to) = particles%p(:, k, from)
    end do
    particles%id(:, to) = particles%id(:, from)
  end subroutine move_chunk

  !> Blocks, groups and chunks of a message
  pure subroutine count_heard(components, heard, blocks, groups, chunks)
    integer, intent(in) :: components
    integer(i8), intent(in) :: heard(:)
    integer, intent(out) :: blocks, groups, chunks
    integer(i8) :: at
    integer :: g, n
    blocks = 0
    groups = 0
    chunks = 0
    at = 0
    do while (at < size(heard, kind=i8))
      blocks = blocks + 1
      n = int(heard(at + 2))
      at = at + 2
      do g = 1, n
        groups = groups + 1
        chunks = chunks + int(heard(at + 2))
        at = at + 2 + heard(at + 2)*(lanes + words_of(lanes*components))
      end do
    end do
  end subroutine count_heard

  !> Put the blocks of a message where they belong; chunks follow those up to `chunk`
  subroutine unpack_blocks(particles, heard, block_at, groups, chunk)
    type(particles_t), intent(inout) :: particles
    integer(i8), intent(in), target :: heard(:)
    integer, intent(out) :: block_at(:, :)
    type(group_t), intent(inout) :: groups(:)
    integer, intent(in) :: chunk
    real(wp), pointer, contiguous :: fields(:, :)
    integer(i8) :: at
    integer :: b, g, n, c, i, k
    b = 0
    g = 0
    c = chunk
    at = 0
    do while (at < size(heard, kind=i8))
      b = b + 1
      block_at(:, b) = block_at_key(heard(at + 1))
      n = int(heard(at + 2))
      at = at + 2
      do i = 1, n
        g = g + 1
        groups(g) = group_t(0, int(heard(at + 1)), c + 1, c + int(heard(at + 2)), block_at(:, b))
        at = at + 2
        do k = groups(g)%first, groups(g)%last
          particles%id(:, k) = heard(at + 1:at + lanes)
          at = at + lanes
          call c_f_pointer(c_loc(heard(at + 1)), fields, [lanes, particles%components])
          particles%p(:, :, k) = fields
          at = at + words_of(lanes*particles%components)
        end do
        c = groups(g)%last
      end do
    end do
  end subroutine unpack_blocks

  !> Blocks are numbered in the order of their groups
  subroutine number_groups(particles)
    type(particles_t), intent(inout) :: particles
    logical :: begins(size(particles%groups))
    integer :: g, b
    begins = .true.
    b = 0
    do g = 1, size(particles%groups)
      if (g > 1) begins(g) = any(particles%groups(g)%at /= particles%groups(g - 1)%at)
      if (begins(g)) b = b + 1
      particles%groups(g)%block = b
    end do
    particles%block_group = [pack([(g, g=1, size(particles%groups))], begins), size(particles%groups) + 1]
  end subroutine number_groups

end module gimp_migration
