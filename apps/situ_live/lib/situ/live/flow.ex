defmodule Situ.Live.Flow do
  @moduledoc false
  # When a diff that no one asked for may be sent: at most one is under way, and at most one per `interval_ms`. What
  # changes
  # meanwhile is summed up in the next. The answer to a user's event is never held back.
  #
  # Each such diff carries the event "situ:ack"; the page's hook answers it once the browser has applied the diff.
  # Without
  # the hook (`ack?` false) only the interval counts; a lost answer is given up after `timeout_ms`. Pure: times are
  # milliseconds, given by the caller.

  defstruct ack?: false, interval_ms: 33, timeout_ms: 5_000, sent_at: nil, waiting?: false

  @type t :: %__MODULE__{}

  @spec new(keyword() | map()) :: t()
  def new(opts \\ []), do: struct!(__MODULE__, opts)

  @doc "`:now`, or after how many milliseconds to ask again."
  @spec check(t(), integer()) :: :now | {:wait, non_neg_integer()}
  def check(%__MODULE__{sent_at: nil}, _now), do: :now

  def check(%__MODULE__{waiting?: true} = flow, now) do
    left = flow.sent_at + flow.timeout_ms - now
    if left <= 0, do: :now, else: {:wait, left}
  end

  def check(%__MODULE__{} = flow, now) do
    left = flow.sent_at + flow.interval_ms - now
    if left <= 0, do: :now, else: {:wait, left}
  end

  @spec sent(t(), integer()) :: t()
  def sent(%__MODULE__{} = flow, now), do: %{flow | sent_at: now, waiting?: flow.ack?}

  @spec acknowledged(t()) :: t()
  def acknowledged(%__MODULE__{} = flow), do: %{flow | waiting?: false}
end
