!> Processes that send messages (MPI). A rank that meets an error of the library ends the job: MPI's own rule.
submodule(gimp_ranks) gimp_ranks_mpi
  use mpi_f08
  use, intrinsic :: iso_c_binding, only: c_f_pointer
  use, intrinsic :: iso_fortran_env, only: error_unit, output_unit
  use gimp_common_kinds, only: dp
  use gimp_timer, only: seconds_now
  use gimp_traffic, only: book, of_pads, of_lists, of_all
  use gimp_exact_sum, only: words_of_sum, merge_sums
  implicit none(type, external)
  type(MPI_Op) :: merging = MPI_OP_NULL !! of exact sums
  type(MPI_Datatype) :: one_sum = MPI_DATATYPE_NULL
  integer, parameter :: pads = 1, lists = 2 !! tags
  integer(i8), parameter :: most = 2_i8**27 !! words in one message; longer ones go in pieces: a count is a default integer
contains

  module procedure start_ranks
    integer :: provided
    call MPI_Init_thread(MPI_THREAD_FUNNELED, provided)
    call MPI_Comm_rank(MPI_COMM_WORLD, this_rank)
    call MPI_Comm_size(MPI_COMM_WORLD, ranks)
    backend = "mpi"
    call MPI_Op_create(merge_op, .true., merging)
    call MPI_Type_contiguous(words_of_sum, MPI_INTEGER8, one_sum)
    call MPI_Type_commit(one_sum)
  end procedure start_ranks

  module procedure end_ranks
    flush (output_unit) ! before anyone leaves: mpirun kills the others once one has left with another code than 0
    flush (error_unit)
    call MPI_Barrier(MPI_COMM_WORLD)
    call MPI_Finalize()
    stop code, quiet=.true.
  end procedure end_ranks

  module procedure end_all_ranks
    flush (output_unit)
    flush (error_unit)
    call MPI_Abort(MPI_COMM_WORLD, code)
    stop code, quiet=.true. ! not reached
  end procedure end_all_ranks

  module procedure wait_for_ranks
    real(dp) :: since
    since = seconds_now()
    call MPI_Barrier(MPI_COMM_WORLD)
    call book(of_all, 1_i8, 0_i8, since)
  end procedure wait_for_ranks

  module procedure share_words
    real(dp) :: since
    integer(i8) :: i, n
    since = seconds_now()
    do i = 1, size(words, kind=i8), most
      n = min(most, size(words, kind=i8) - i + 1)
      call MPI_Bcast(words(i:i + n - 1), int(n), MPI_INTEGER8, root, MPI_COMM_WORLD)
    end do
    call book(of_all, 1_i8, merge(size(words, kind=i8), 0_i8, this_rank == root), since)
  end procedure share_words

  module procedure gather_words
    real(dp) :: since
    since = seconds_now()
    call MPI_Allgather(mine, size(mine), MPI_INTEGER8, all, size(mine), MPI_INTEGER8, MPI_COMM_WORLD)
    call book(of_all, 1_i8, size(mine, kind=i8), since)
  end procedure gather_words

  module procedure sum_words
    real(dp) :: since
    since = seconds_now()
    call MPI_Allreduce(MPI_IN_PLACE, words, size(words), MPI_INTEGER8, MPI_SUM, MPI_COMM_WORLD)
    call book(of_all, 1_i8, size(words, kind=i8), since)
  end procedure sum_words

  module procedure largest_words
    real(dp) :: since
    since = seconds_now()
    call MPI_Allreduce(MPI_IN_PLACE, words, size(words), MPI_INTEGER8, MPI_MAX, MPI_COMM_WORLD)
    call book(of_all, 1_i8, size(words, kind=i8), since)
  end procedure largest_words

  module procedure words_before
    integer(i8) :: mine(size(words))
    real(dp) :: since
    since = seconds_now()
    mine = words
    call MPI_Exscan(mine, words, size(words), MPI_INTEGER8, MPI_SUM, MPI_COMM_WORLD)
    if (this_rank == 0) words = 0 ! MPI leaves it undefined there
    call book(of_all, 1_i8, size(words, kind=i8), since)
  end procedure words_before

  module procedure reduce_sums
    real(dp) :: since
    since = seconds_now()
    call MPI_Allreduce(MPI_IN_PLACE, words, size(words, 2), one_sum, merging, MPI_COMM_WORLD)
    call book(of_all, 1_i8, size(words, kind=i8), since)
  end procedure reduce_sums

  !> MPI asks for this when it merges
  subroutine merge_op(invec, inoutvec, len, datatype)
    use, intrinsic :: iso_c_binding, only: c_ptr
    type(c_ptr), value :: invec, inoutvec
    integer :: len
    type(MPI_Datatype) :: datatype
    integer(i8), pointer :: more(:, :), sums(:, :)
    call c_f_pointer(invec, more, [words_of_sum, len])
    call c_f_pointer(inoutvec, sums, [words_of_sum, len])
    call merge_sums(sums, more)
  end subroutine merge_op

  module procedure exchange_words
    type(MPI_Request), allocatable :: request(:)
    integer(i8) :: first, at, n
    real(dp) :: since
    integer :: k, r
    since = seconds_now()
    call MPI_Alltoall(to_count, 1, MPI_INTEGER8, from_count, 1, MPI_INTEGER8, MPI_COMM_WORLD)
    allocate (from(sum(from_count)))
    allocate (request(sum(pieces(from_count)) + sum(pieces(to_count))))
    k = 0
    first = 1
    do r = 0, ranks - 1
      do at = 0, from_count(r) - 1, most
        n = min(most, from_count(r) - at)
        k = k + 1
        call receive(from(first + at:first + at + n - 1), int(n), r, lists, request(k))
      end do
      first = first + from_count(r)
    end do
    first = 1
    do r = 0, ranks - 1
      do at = 0, to_count(r) - 1, most
        n = min(most, to_count(r) - at)
        k = k + 1
        call send(to(first + at:first + at + n - 1), int(n), r, lists, request(k))
      end do
      first = first + to_count(r)
    end do
    call MPI_Waitall(k, request, MPI_STATUSES_IGNORE)
    n = to_count(this_rank)
    call book(of_lists, int(count(to_count > 0), i8) - merge(1, 0, n > 0), sum(to_count) - n, since)
  end procedure exchange_words

  !> Messages that so many words are sent in
  pure elemental integer(i8) function pieces(words)
    integer(i8), intent(in) :: words
    pieces = (words + most - 1)/most
  end function pieces

  !> Begin to receive a message
  subroutine receive(words, n, rank, tag, request)
    integer(i8), intent(inout), asynchronous, target :: words(*)
    integer, intent(in) :: n, rank, tag
    type(MPI_Request), intent(out) :: request
    call MPI_Irecv(words, n, MPI_INTEGER8, rank, tag, MPI_COMM_WORLD, request)
  end subroutine receive

  !> Begin to send a message
  subroutine send(words, n, rank, tag, request)
    integer(i8), intent(in), asynchronous, target :: words(*)
    integer, intent(in) :: n, rank, tag
    type(MPI_Request), intent(out) :: request
    call MPI_Isend(words, n, MPI_INTEGER8, rank, tag, MPI_COMM_WORLD, request)
  end subroutine send

  module procedure open_channel
    integer :: n
    n = size(channel%to)
    associate (to => channel%to_first(n + 1), from => channel%from_first(size(channel%from) + 1))
      allocate (channel%out(to - 1), channel%in(from - 1))
    end associate
    allocate (channel%to_words(n), channel%from_words(size(channel%from)), source=0_i8)
    allocate (channel%request(sum(pieces(rooms(channel%to_first))) + sum(pieces(rooms(channel%from_first)))))
  end procedure open_channel

  !> Words that each message may have
  pure function rooms(first)
    integer(i8), intent(in) :: first(:)
    integer(i8) :: rooms(size(first) - 1)
    rooms = first(2:) - first(:size(first) - 1)
  end function rooms

  module procedure close_channel
    call finish_exchange(channel)
    if (associated(channel%out)) deallocate (channel%out, channel%in)
    channel = channel_t()
  end procedure close_channel

  module procedure start_exchange
    type(MPI_Request) :: request
    integer(i8) :: at, n, last
    integer :: k, p
    p = 0
    do k = 1, size(channel%from)
      do at = channel%from_first(k), channel%from_first(k + 1) - 1, most
        n = min(most, channel%from_first(k + 1) - at)
        call receive(channel%in(at:at + n - 1), int(n), channel%from(k), pads, request)
        p = p + 1
        channel%request(p) = request%mpi_val
      end do
    end do
    do k = 1, size(channel%to)
      last = channel%to_first(k) + channel%to_words(k) - 1
      do at = channel%to_first(k), channel%to_first(k + 1) - 1, most ! as many pieces as the receiver expects
        n = max(0_i8, min(most, last - at + 1))
        call send(channel%out(at:at + n - 1), int(n), channel%to(k), pads, request)
        p = p + 1
        channel%request(p) = request%mpi_val
      end do
    end do
    channel%under_way = .true.
  end procedure start_exchange

  module procedure finish_exchange
    type(MPI_Request), allocatable :: request(:)
    type(MPI_Status), allocatable :: status(:)
    integer(i8) :: at
    real(dp) :: since
    integer :: k, n, p
    if (.not. channel%under_way) return
    since = seconds_now()
    allocate (request(size(channel%request)), status(size(channel%request)))
    request%mpi_val = channel%request
    call MPI_Waitall(size(request), request, status)
    p = 0
    channel%from_words = 0
    do k = 1, size(channel%from)
      do at = channel%from_first(k), channel%from_first(k + 1) - 1, most
        p = p + 1
        call MPI_Get_count(status(p), MPI_INTEGER8, n)
        channel%from_words(k) = channel%from_words(k) + n
      end do
    end do
    channel%under_way = .false.
    call book(of_pads, int(size(channel%to), i8), sum(channel%to_words), since)
  end procedure finish_exchange

end submodule gimp_ranks_mpi
