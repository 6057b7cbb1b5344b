defmodule Situ.Fusion.Member do
  @moduledoc false
  # A secondary stream of a fusion: its input, the key of its values, and the span of originating times for which it
  # takes part. `from` is the first time at which it is needed (`nil`: at all times). `until` is the first time at
  # which it is no longer needed.
  alias Situ.Fusion.SecondaryQueue

  @enforce_keys [:input, :key, :interpolator]
  defstruct [:input, :key, :interpolator, :from, :until, queue: SecondaryQueue.new()]

  @type t :: %__MODULE__{
          input: atom(),
          key: term(),
          interpolator: Situ.Interpolator.t(),
          from: Situ.Time.t() | nil,
          until: Situ.Time.t() | nil,
          queue: SecondaryQueue.t()
        }

  @doc "Returns the messages at or after `from`, which are the ones the member uses."
  @spec messages_since([Situ.Message.t()], Situ.Time.t() | nil) :: [Situ.Message.t()]
  def messages_since(messages, nil), do: messages

  def messages_since([%{originating_time: time} | rest], from) when time < from,
    do: messages_since(rest, from)

  def messages_since(messages, _from), do: messages
end
