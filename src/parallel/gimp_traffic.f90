!> The books of working together: what this rank has sent, and how long it waited for the others
module gimp_traffic
  use gimp_common_kinds, only: dp, i8
  use gimp_timer, only: seconds_now
  implicit none(type, external)
  private
  public :: traffic_t, traffic, of_pads, of_lists, of_all, book

  !> What one way of working together has cost so far
  type :: traffic_t
    integer(i8) :: calls = 0
    integer(i8) :: messages = 0 !! sent to other ranks
    integer(i8) :: words = 0 !! of 64 bits, in those
    real(dp) :: seconds = 0.0_dp !! waited
  end type traffic_t

  integer, parameter :: of_pads = 1 !! channels
  integer, parameter :: of_lists = 2 !! exchange_words
  integer, parameter :: of_all = 3 !! what all ranks share, gather, reduce or wait for; a call counts as one message
  type(traffic_t), protected :: traffic(3) !! nothing of it when there is one process alone

contains

  !> Enter a call; for the bodies of gimp_ranks
  subroutine book(kind, messages, words, since)
    integer, intent(in) :: kind
    integer(i8), intent(in) :: messages, words
    real(dp), intent(in) :: since !! clock when the wait began
    traffic(kind)%calls = traffic(kind)%calls + 1
    traffic(kind)%messages = traffic(kind)%messages + messages
    traffic(kind)%words = traffic(kind)%words + words
    traffic(kind)%seconds = traffic(kind)%seconds + (seconds_now() - since)
  end subroutine book

end module gimp_traffic
