!> Processes that send messages (MPI). A rank that meets an error of the library ends the job: MPI's own rule.
submodule(gimp_ranks) gimp_ranks_mpi
  use mpi_f08
  use, intrinsic :: iso_c_binding, only: c_f_pointer
  use gimp_exact_sum, only: words_of_sum, merge_sums
  implicit none(type, external)
  type(MPI_Op) :: merging = MPI_OP_NULL !! of exact sums
  type(MPI_Datatype) :: one_sum = MPI_DATATYPE_NULL
  integer, parameter :: pads = 1, lists = 2 !! tags
  integer(i8), parameter :: most = 2_i8**27 !! words in one message of a list: a count is a default integer
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
    call MPI_Finalize()
    stop code, quiet=.true.
  end procedure end_ranks

  module procedure end_all_ranks
    call MPI_Abort(MPI_COMM_WORLD, code)
    stop code, quiet=.true. ! not reached
  end procedure end_all_ranks

  module procedure wait_for_ranks
    call MPI_Barrier(MPI_COMM_WORLD)
  end procedure wait_for_ranks

  module procedure share_words
    integer(i8) :: i, n
    do i = 1, size(words, kind=i8), most
      n = min(most, size(words, kind=i8) - i + 1)
      call MPI_Bcast(words(i:i + n - 1), int(n), MPI_INTEGER8, root, MPI_COMM_WORLD)
    end do
  end procedure share_words

  module procedure gather_words
    call MPI_Allgather(mine, size(mine), MPI_INTEGER8, all, size(mine), MPI_INTEGER8, MPI_COMM_WORLD)
  end procedure gather_words

  module procedure sum_words
    call MPI_Allreduce(MPI_IN_PLACE, words, size(words), MPI_INTEGER8, MPI_SUM, MPI_COMM_WORLD)
  end procedure sum_words

  module procedure largest_words
    call MPI_Allreduce(MPI_IN_PLACE, words, size(words), MPI_INTEGER8, MPI_MAX, MPI_COMM_WORLD)
  end procedure largest_words

  module procedure words_before
    integer(i8) :: mine(size(words))
    mine = words
    call MPI_Exscan(mine, words, size(words), MPI_INTEGER8, MPI_SUM, MPI_COMM_WORLD)
    if (this_rank == 0) words = 0 ! MPI leaves it undefined there
  end procedure words_before

  module procedure reduce_sums
    call MPI_Allreduce(MPI_IN_PLACE, words, size(words, 2), one_sum, merging, MPI_COMM_WORLD)
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
    integer(i8) :: first, at, n, pieces
    integer :: k, r
    call MPI_Alltoall(to_count, 1, MPI_INTEGER8, from_count, 1, MPI_INTEGER8, MPI_COMM_WORLD)
    allocate (from(sum(from_count)))
    pieces = sum((from_count + most - 1)/most) + sum((to_count + most - 1)/most)
    allocate (request(pieces))
    k = 0
    first = 1
    do r = 0, ranks - 1
      do at = 0, from_count(r) - 1, most
        n = min(most, from_count(r) - at)
        k = k + 1
        call receive(from(first + at:first + at + n - 1), int(n), r, request(k))
      end do
      first = first + from_count(r)
    end do
    first = 1
    do r = 0, ranks - 1
      do at = 0, to_count(r) - 1, most
        n = min(most, to_count(r) - at)
        k = k + 1
        call send(to(first + at:first + at + n - 1), int(n), r, request(k))
      end do
      first = first + to_count(r)
    end do
    call MPI_Waitall(k, request, MPI_STATUSES_IGNORE)
  end procedure exchange_words

  !> Begin to receive a list
  subroutine receive(words, n, rank, request)
    integer(i8), intent(inout), asynchronous :: words(*)
    integer, intent(in) :: n, rank
    type(MPI_Request), intent(out) :: request
    call MPI_Irecv(words, n, MPI_INTEGER8, rank, lists, MPI_COMM_WORLD, request)
  end subroutine receive

  !> Begin to send a list
  subroutine send(words, n, rank, request)
    integer(i8), intent(in), asynchronous :: words(*)
    integer, intent(in) :: n, rank
    type(MPI_Request), intent(out) :: request
    call MPI_Isend(words, n, MPI_INTEGER8, rank, lists, MPI_COMM_WORLD, request)
  end subroutine send

  module procedure open_channel
    allocate (channel%out(channel%to_first(size(channel%to) + 1) - 1), channel%in(channel%from_first(size(channel%from) + 1) - 1))
    allocate (channel%to_words(size(channel%to)), channel%from_words(size(channel%from)), source=0_i8)
    allocate (channel%request(size(channel%to) + size(channel%from)))
  end procedure open_channel

  module procedure close_channel
    if (associated(channel%out)) deallocate (channel%out, channel%in)
    channel = channel_t()
  end procedure close_channel

  module procedure start_exchange
    type(MPI_Request) :: request
    integer :: k
    do k = 1, size(channel%from)
      call begin_receive(channel%in(channel%from_first(k):channel%from_first(k + 1) - 1), &
                         int(channel%from_first(k + 1) - channel%from_first(k)), channel%from(k), request)
      channel%request(k) = request%mpi_val
    end do
    do k = 1, size(channel%to)
      call begin_send(channel%out(channel%to_first(k):channel%to_first(k) + channel%to_words(k) - 1), int(channel%to_words(k)), &
                      channel%to(k), request)
      channel%request(size(channel%from) + k) = request%mpi_val
    end do
    channel%under_way = .true.
  end procedure start_exchange

  subroutine begin_receive(words, n, rank, request)
    integer(i8), intent(inout), asynchronous :: words(*)
    integer, intent(in) :: n, rank
    type(MPI_Request), intent(out) :: request
    call MPI_Irecv(words, n, MPI_INTEGER8, rank, pads, MPI_COMM_WORLD, request)
  end subroutine begin_receive

  subroutine begin_send(words, n, rank, request)
    integer(i8), intent(in), asynchronous :: words(*)
    integer, intent(in) :: n, rank
    type(MPI_Request), intent(out) :: request
    call MPI_Isend(words, n, MPI_INTEGER8, rank, pads, MPI_COMM_WORLD, request)
  end subroutine begin_send

  module procedure finish_exchange
    type(MPI_Request) :: request(size(channel%request))
    type(MPI_Status) :: status(size(channel%request))
    integer :: k, n
    if (.not. channel%under_way) return
    request%mpi_val = channel%request
    call MPI_Waitall(size(request), request, status)
    do k = 1, size(channel%from)
      call MPI_Get_count(status(k), MPI_INTEGER8, n)
      channel%from_words(k) = n
    end do
    channel%under_way = .false.
  end procedure finish_exchange

end submodule gimp_ranks_mpi
