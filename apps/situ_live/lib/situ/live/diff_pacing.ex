defmodule Situ.Live.DiffPacing do
  @moduledoc false
  # Decides when a diff that the browser did not request may be sent: at most one is in flight, and at most one is sent
  # per `interval_ms`. The next diff combines all changes since the last one. Replies to user events are never delayed.
  #
  # Each such diff carries the event "situ:ack", and the page's hook acknowledges it once the browser has applied the
  # diff. Without the hook (`ack?` is false) only the interval counts. After `timeout_ms` a missing acknowledgement is
  # no longer awaited. The module is pure: the caller passes times in milliseconds.
  #
  # The client applies a diff on the main thread of the browser, which takes about 70 ms on a
  # large page, and the protocol does not report when it has finished. Without pacing, a server
  # that pushes 60 diffs a second makes such a page seconds late.

  defstruct ack?: false, interval_ms: 33, timeout_ms: 5_000, sent_at: nil, awaiting_ack?: false

  @type t :: %__MODULE__{}

  @spec new(keyword() | map()) :: t()
  def new(opts \\ []), do: struct!(__MODULE__, opts)

  @doc "Returns `:now`, or `{:wait, ms}` with the time after which to check again."
  @spec time_to_send(t(), integer()) :: :now | {:wait, non_neg_integer()}
  def time_to_send(%__MODULE__{sent_at: nil}, _now), do: :now

  def time_to_send(%__MODULE__{awaiting_ack?: true} = pacing, now) do
    wait_ms = pacing.sent_at + pacing.timeout_ms - now
    if wait_ms <= 0, do: :now, else: {:wait, wait_ms}
  end

  def time_to_send(%__MODULE__{} = pacing, now) do
    wait_ms = pacing.sent_at + pacing.interval_ms - now
    if wait_ms <= 0, do: :now, else: {:wait, wait_ms}
  end

  @spec record_sent(t(), integer()) :: t()
  def record_sent(%__MODULE__{} = pacing, now),
    do: %{pacing | sent_at: now, awaiting_ack?: pacing.ack?}

  @spec record_ack(t()) :: t()
  def record_ack(%__MODULE__{} = pacing), do: %{pacing | awaiting_ack?: false}
end
