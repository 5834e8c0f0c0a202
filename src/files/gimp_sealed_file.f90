!> A seal on a finished file: its kind, format version, length and a checksum of every byte, in its first 512 bytes.
!>
!> HDF5 leaves these bytes alone (its user block). The seal is looked at before the library sees the file, so that damage is told
!> in words wherever it is: the library checks few of its own structures and trusts the rest.
module gimp_sealed_file
  use, intrinsic :: iso_c_binding, only: c_loc
  use gimp_common_kinds, only: i8
  use gimp_error, only: error_t, raise
  use gimp_text, only: text_of
  use gimp_hash_table, only: mix_bits
  use gimp_file_system, only: raw_file_t, open_raw_file, write_at, sync_raw_file, close_raw_file, file_exists, file_bytes
  implicit none(type, external)
  private
  public :: seal_bytes, seal_file, check_seal

  integer, parameter :: seal_bytes = 512
  integer, parameter :: digits_first = 97, digits_last = 112 !! where the checksum stands; blank while it is formed
  integer(i8), parameter :: piece = 2_i8**17 !! words read at a time

contains

  !> Seal a file that nobody has open, and wait until it is on the device
  subroutine seal_file(path, kind, version, error)
    character(len=*), intent(in) :: path !! its first `seal_bytes` bytes are ours
    character(len=*), intent(in) :: kind !! at most 32 characters
    integer, intent(in) :: version
    type(error_t), allocatable, intent(out) :: error
    type(raw_file_t) :: raw
    character(len=seal_bytes), target :: seal
    integer(i8) :: hash
    integer :: k
    seal = repeat(char(0), seal_bytes)
    write (seal(:95), "(a32, a, i12, a, i20)") adjustl(kind//repeat(" ", 32)), " version ", version, " bytes ", file_bytes(path)
    seal(96:96) = " "
    seal(digits_first:digits_last) = ""
    seal(digits_last + 1:digits_last + 1) = new_line("a")
    call open_raw_file(path, raw, error)
    if (allocated(error)) return
    do k = 1, 2 ! first without the checksum, which is formed of the whole file
      call write_at(raw, 0_i8, c_loc(seal), int(seal_bytes, i8), error)
      if (allocated(error) .or. k == 2) exit
      call form_checksum(path, hash, error)
      if (allocated(error)) exit
      write (seal(digits_first:digits_last), "(z16.16)") hash
    end do
    if (.not. allocated(error)) call sync_raw_file(raw, error)
    if (allocated(error)) then
      call discard(raw)
    else
      call close_raw_file(raw, error)
    end if
  end subroutine seal_file

  subroutine discard(raw)
    type(raw_file_t), intent(inout) :: raw
    type(error_t), allocatable :: ignored
    call close_raw_file(raw, ignored)
  end subroutine discard

  !> Whether a file is whole, of that kind and not of a newer format than `newest`; every byte of it is looked at
  subroutine check_seal(path, kind, newest, error)
    character(len=*), intent(in) :: path, kind
    integer, intent(in) :: newest
    type(error_t), allocatable, intent(out) :: error
    character(len=seal_bytes) :: seal
    character(len=16) :: digits
    integer(i8) :: bytes, hash
    integer :: version, status
    if (.not. file_exists(path)) then
      call raise(error, path//": no such file")
      return
    end if
    call read_seal(path, seal, status)
    if (status /= 0 .or. seal(:32) /= kind) then
      call raise(error, path//": is not a "//kind)
      return
    end if
    read (seal, "(32x, 9x, i12, 7x, i20)", iostat=status) version, bytes
    if (status /= 0) then
      call raise(error, path//": is damaged")
    else if (version > newest) then
      call raise(error, path//": has format version "//text_of(version)//", newer than the "//text_of(newest) &
        //" that this program knows")
    else if (file_bytes(path) /= bytes) then
      call raise(error, path//": is damaged: it has "//text_of(file_bytes(path))//" bytes instead of "//text_of(bytes))
    end if
    if (allocated(error)) return
    call form_checksum(path, hash, error)
    if (allocated(error)) return
    write (digits, "(z16.16)") hash
    if (digits /= seal(digits_first:digits_last)) call raise(error, path//": is damaged: its checksum is wrong")
  end subroutine check_seal

  subroutine read_seal(path, seal, status)
    character(len=*), intent(in) :: path
    character(len=seal_bytes), intent(out) :: seal
    integer, intent(out) :: status
    integer :: unit
    seal = ""
    open (newunit=unit, file=path, access="stream", form="unformatted", action="read", status="old", iostat=status)
    if (status /= 0) return
    read (unit, iostat=status) seal
    close (unit)
  end subroutine read_seal

  !> A number that depends on every byte of a file and on their order; the digits of the seal count as blanks
  subroutine form_checksum(path, hash, error)
    character(len=*), intent(in) :: path
    integer(i8), intent(out) :: hash
    type(error_t), allocatable, intent(out) :: error
    integer(i8), allocatable :: words(:)
    character(len=8) :: rest
    integer(i8) :: bytes, done, n, k
    integer :: unit, status
    hash = 0
    bytes = file_bytes(path)
    open (newunit=unit, file=path, access="stream", form="unformatted", action="read", status="old", iostat=status)
    if (status == 0) then
      allocate (words(max(64_i8, min(piece, bytes/8))))
      done = 0
      do while (done < bytes/8 .and. status == 0)
        n = min(piece, bytes/8 - done)
        read (unit, iostat=status) words(:n)
        if (done == 0) words((digits_first - 1)/8 + 1:digits_last/8) = transfer(repeat(" ", 16), words, 2)
        do k = 1, n
          hash = mix_bits(ieor(hash, words(k)) + k) ! k: a word of zeros must change the sum
        end do
        done = done + n
      end do
      rest = ""
      if (status == 0 .and. mod(bytes, 8_i8) > 0) read (unit, iostat=status) rest(:mod(bytes, 8_i8))
      hash = mix_bits(ieor(hash, transfer(rest, 0_i8)))
      close (unit)
    end if
    if (status /= 0) call raise(error, path//": cannot be read to its end")
  end subroutine form_checksum

end module gimp_sealed_file
