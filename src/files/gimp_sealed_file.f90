!> A seal on a finished file: its kind, format version, length and a checksum of every byte, in its first 512 bytes.
!>
!> HDF5 leaves these bytes alone (its user block). The seal is looked at before the library sees the file, so that damage is told
!> in words wherever it is: the library checks few of its own structures and trusts the rest. The checksum is a sum over pieces of
!> the file, each hashed with its number, so that ranks and threads share the pieces and the sum knows nothing of them.
module gimp_sealed_file
  use, intrinsic :: iso_c_binding, only: c_loc
  use gimp_common_kinds, only: i8
  use gimp_error, only: error_t, raise
  use gimp_text, only: text_of
  use gimp_hash_table, only: mix_bits
  use gimp_shares, only: share_t, items_of_share
  use gimp_ranks, only: this_rank, ranks, share_words, sum_words
  use gimp_over_ranks, only: share_text, share_error
  use gimp_file_system, only: raw_file_t, open_raw_file, write_at, read_at, sync_raw_file, close_raw_file, file_exists, file_bytes
  implicit none(type, external)
  private
  public :: seal_bytes, seal_file, check_seal, hash_pieces

  integer, parameter :: seal_bytes = 512
  integer, parameter :: digits_first = 97, digits_last = 112 !! where the checksum stands; blank while it is formed
  integer, parameter :: piece_words = 2**18 !! 64-bit words that are hashed together

contains

  !> Seal a file that nobody has open and whose bytes are on the device, and wait until the seal is there, too. Collective
  subroutine seal_file(path, kind, version, error)
    character(len=*), intent(in) :: path !! its first `seal_bytes` bytes are ours
    character(len=*), intent(in) :: kind !! at most 32 characters
    integer, intent(in) :: version
    type(error_t), allocatable, intent(out) :: error
    character(len=seal_bytes) :: seal
    integer(i8) :: bytes(1), hash
    if (this_rank == 0) bytes = file_bytes(path)
    call share_words(0, bytes)
    seal = repeat(char(0), seal_bytes)
    write (seal(:95), "(a32, a, i12, a, i20)") adjustl(kind//repeat(" ", 32)), " version ", version, " bytes ", bytes(1)
    seal(96:96) = " "
    seal(digits_last + 1:digits_last + 1) = new_line("a")
    call form_checksum(path, seal, bytes(1), hash, error)
    if (allocated(error)) return
    write (seal(digits_first:digits_last), "(z16.16)") hash
    if (this_rank == 0) call write_seal(path, seal, error)
    call share_error(error)
  end subroutine seal_file

  subroutine write_seal(path, seal, error)
    character(len=*), intent(in) :: path
    character(len=seal_bytes), intent(in), target :: seal
    type(error_t), allocatable, intent(out) :: error
    type(raw_file_t) :: raw
    type(error_t), allocatable :: problem
    call open_raw_file(path, raw, error)
    if (allocated(error)) return
    call write_at(raw, 0_i8, c_loc(seal), int(seal_bytes, i8), error)
    if (.not. allocated(error)) call sync_raw_file(raw, error)
    call close_raw_file(raw, problem)
    if (.not. allocated(error)) call move_alloc(problem, error)
  end subroutine write_seal

  !> Whether a file is whole, of that kind and of that format version; every byte of it is looked at. Collective
  subroutine check_seal(path, kind, version, error)
    character(len=*), intent(in) :: path, kind
    integer, intent(in) :: version
    type(error_t), allocatable, intent(out) :: error
    character(len=:), allocatable :: seal
    character(len=16) :: digits
    integer(i8) :: bytes(1), hash
    seal = repeat(" ", seal_bytes)
    bytes = 0
    if (this_rank == 0) call look_at_seal(path, kind, version, seal, bytes(1), error)
    call share_error(error)
    if (allocated(error)) return
    call share_text(0, seal)
    call share_words(0, bytes)
    call form_checksum(path, seal, bytes(1), hash, error)
    if (allocated(error)) return
    write (digits, "(z16.16)") hash
    if (digits /= seal(digits_first:digits_last)) call raise(error, path//": is damaged: its checksum is wrong")
  end subroutine check_seal

  !> Read the seal and check all but the checksum
  subroutine look_at_seal(path, kind, version, seal, bytes, error)
    character(len=*), intent(in) :: path, kind
    integer, intent(in) :: version
    character(len=seal_bytes), intent(out) :: seal
    integer(i8), intent(out) :: bytes !! of the file, as the seal has it
    type(error_t), allocatable, intent(out) :: error
    integer :: found, status
    seal = ""
    bytes = 0
    if (.not. file_exists(path)) then
      call raise(error, path//": no such file")
      return
    end if
    call read_seal(path, seal, error)
    if (allocated(error) .or. seal(:32) /= kind) then
      call raise(error, path//": is not a "//kind)
      return
    end if
    read (seal, "(32x, 9x, i12, 7x, i20)", iostat=status) found, bytes
    if (status /= 0) then
      call raise(error, path//": is damaged")
    else if (found > version) then
      call raise(error, path//": has format version "//text_of(found)//", newer than the "//text_of(version) &
        //" that this program knows")
    else if (found < version) then
      call raise(error, path//": has format version "//text_of(found)//", older than the "//text_of(version) &
        //" that this program knows; the gimp.x that wrote it can go on from it")
    else if (file_bytes(path) /= bytes) then
      call raise(error, path//": is damaged: it has "//text_of(file_bytes(path))//" bytes instead of "//text_of(bytes))
    end if
  end subroutine look_at_seal

  subroutine read_seal(path, seal, error)
    character(len=*), intent(in) :: path
    character(len=seal_bytes), intent(inout), target :: seal
    type(error_t), allocatable, intent(out) :: error
    type(raw_file_t) :: raw
    type(error_t), allocatable :: ignored
    call open_raw_file(path, raw, error, only_read=.true.)
    if (allocated(error)) return
    call read_at(raw, 0_i8, c_loc(seal), int(seal_bytes, i8), error)
    call close_raw_file(raw, ignored)
  end subroutine read_seal

  !> A number that depends on every byte of a file and on their order; the digits of the seal count as blanks. Collective
  subroutine form_checksum(path, seal, bytes, hash, error)
    character(len=*), intent(in) :: path
    character(len=seal_bytes), intent(in) :: seal !! as it is to be, or as it stands in the file
    integer(i8), intent(in) :: bytes !! of the file
    integer(i8), intent(out) :: hash
    type(error_t), allocatable, intent(out) :: error
    character(len=seal_bytes) :: blank
    integer(i8) :: total(1)
    total = 0
    call hash_pieces(path, bytes, share_t(this_rank, ranks), total(1), error)
    call share_error(error)
    if (allocated(error)) return
    call sum_words(total)
    blank = seal
    blank(digits_first:digits_last) = ""
    hash = total(1) + hash_words(transfer(blank, [0_i8], seal_bytes/8), 0_i8)
  end subroutine form_checksum

  !> Sum of the hashes of a share of the pieces behind the seal
  subroutine hash_pieces(path, bytes, share, total, error)
    character(len=*), intent(in) :: path
    integer(i8), intent(in) :: bytes !! of the file
    type(share_t), intent(in) :: share
    integer(i8), intent(out) :: total
    type(error_t), allocatable, intent(out) :: error
    type(raw_file_t) :: raw
    type(error_t), allocatable :: ignored
    integer(i8) :: mine(2), k
    total = 0
    mine = items_of_share(share, (max(0_i8, bytes - seal_bytes) + 8*piece_words - 1)/(8*piece_words))
    call open_raw_file(path, raw, error, only_read=.true.)
    if (allocated(error)) return
    !$omp parallel do schedule(dynamic, 1) reduction(+:total) if(mine(2) > mine(1))
    do k = mine(1), mine(2)
      call add_piece(raw, bytes, k, total, error)
    end do
    !$omp end parallel do
    call close_raw_file(raw, ignored)
  end subroutine hash_pieces

  !> Add the hash of one piece; threads share the error
  subroutine add_piece(raw, bytes, number, total, error)
    type(raw_file_t), intent(in) :: raw
    integer(i8), intent(in) :: bytes, number
    integer(i8), intent(inout) :: total
    type(error_t), allocatable, intent(inout) :: error
    type(error_t), allocatable :: problem
    integer(i8), allocatable, target :: words(:)
    integer(i8) :: from, n
    from = seal_bytes + 8_i8*piece_words*(number - 1)
    n = min(8_i8*piece_words, bytes - from)
    allocate (words((n + 7)/8))
    words(size(words)) = 0 ! the last bytes may not fill it
    call read_at(raw, from, c_loc(words), n, problem)
    if (.not. allocated(problem)) then
      total = total + hash_words(words, number)
      return
    end if
    !$omp critical (keep_problem)
    if (.not. allocated(error)) call move_alloc(problem, error)
    !$omp end critical (keep_problem)
  end subroutine add_piece

  !> Hash of a piece and of its number
  pure integer(i8) function hash_words(words, number) result(hash)
    integer(i8), intent(in) :: words(:), number
    integer :: k
    hash = mix_bits(number + 1)
    do k = 1, size(words)
      hash = mix_bits(ieor(hash, words(k)) + k) ! k: a word of zeros must change the sum
    end do
  end function hash_words

end module gimp_sealed_file
