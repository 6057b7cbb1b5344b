defmodule Situ.Bridge.RawMessage do
  @moduledoc """
  A message of an MCAP file or a ROS bag that is not decoded: its bytes, the times in ns since 1970 when it was recorded
  (`log_time`) and sent (`publish_time`), and its sequence number. Bags have no publish time, so both times are equal,
  and no sequence number, so it is 0. See `Situ.Bridge.RawMessages`.
  """
  alias Situ.Bridge.RawChannel

  @enforce_keys [:channel, :log_time, :publish_time, :sequence, :bytes]
  defstruct [:channel, :log_time, :publish_time, :sequence, :bytes]

  @type t :: %__MODULE__{
          channel: RawChannel.t(),
          log_time: Situ.Time.t(),
          publish_time: Situ.Time.t(),
          sequence: non_neg_integer(),
          bytes: binary()
        }
end
