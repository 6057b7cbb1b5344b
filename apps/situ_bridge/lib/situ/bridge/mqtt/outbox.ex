defmodule Situ.Bridge.Mqtt.Outbox do
  @moduledoc false
  # The messages of a publisher that the broker has not confirmed. They are numbered, and the packet identifier follows
  # from the number. With QoS 2, a message is first received by the broker (PUBREC), then confirmed (PUBCOMP). It is
  # kept until then, because a broker that lost its session must get it again. Pure.
  defstruct entries: %{}, oldest: 1, next: 1, last: 0, in_flight: 0

  @ids 65_535
  @type stage :: :waiting | :sent | :received
  @type t :: %__MODULE__{
          entries: %{pos_integer() => {message :: term(), stage(), duplicate? :: boolean()}},
          oldest: pos_integer(),
          next: pos_integer(),
          last: non_neg_integer(),
          in_flight: non_neg_integer()
        }
  @type id :: 1..65_535

  @doc "Returns the number of unconfirmed messages."
  @spec count(t()) :: non_neg_integer()
  def count(outbox), do: map_size(outbox.entries)

  @doc "Adds a message. Returns `:full` with `limit` unconfirmed messages, or if the next identifier is still in use."
  @spec add(t(), message :: term(), limit :: pos_integer()) :: {:ok, t()} | :full
  def add(outbox, message, limit) do
    if count(outbox) >= limit or outbox.last - outbox.oldest >= @ids - 1 do
      :full
    else
      last = outbox.last + 1
      entries = Map.put(outbox.entries, last, {message, :waiting, false})
      {:ok, %{outbox | entries: entries, last: last}}
    end
  end

  @doc """
  Returns the waiting messages that may be sent while at most `window` messages are in flight.

      iex> alias Situ.Bridge.Mqtt.Outbox
      iex> {:ok, outbox} = Outbox.add(%Outbox{}, "a", 10)
      iex> {:ok, outbox} = Outbox.add(outbox, "b", 10)
      iex> {[{1, "a", false}], outbox} = Outbox.take_waiting(outbox, 1)
      iex> {[], outbox} = Outbox.take_waiting(outbox, 1)
      iex> outbox |> Outbox.confirm(1) |> Outbox.take_waiting(1) |> elem(0)
      [{2, "b", false}]
  """
  @spec take_waiting(t(), window :: pos_integer()) :: {[{id(), term(), boolean()}], t()}
  def take_waiting(outbox, window), do: take_waiting(outbox, window, [])

  defp take_waiting(%{next: next, last: last} = outbox, window, taken)
       when next > last or outbox.in_flight >= window,
       do: {Enum.reverse(taken), outbox}

  defp take_waiting(%{next: next} = outbox, window, taken) do
    case outbox.entries do
      %{^next => {message, :waiting, duplicate?}} ->
        entries = Map.put(outbox.entries, next, {message, :sent, duplicate?})
        outbox = %{outbox | entries: entries, next: next + 1, in_flight: outbox.in_flight + 1}
        take_waiting(outbox, window, [{id_of(next), message, duplicate?} | taken])

      _confirmed_or_received ->
        take_waiting(%{outbox | next: next + 1}, window, taken)
    end
  end

  @doc "The broker has received a message (PUBREC)."
  @spec receive(t(), id()) :: t()
  def receive(outbox, id) do
    n = number_of(outbox, id)

    case outbox.entries do
      %{^n => {message, :sent, duplicate?}} ->
        %{outbox | entries: Map.put(outbox.entries, n, {message, :received, duplicate?})}

      _ ->
        outbox
    end
  end

  @doc "The broker has confirmed a message (PUBACK, PUBCOMP), or refuses it. Unknown identifiers are ignored."
  @spec confirm(t(), id()) :: t()
  def confirm(outbox, id) do
    case Map.pop(outbox.entries, number_of(outbox, id)) do
      {{_message, stage, _}, entries} when stage != :waiting ->
        drop_confirmed(%{outbox | entries: entries, in_flight: outbox.in_flight - 1})

      _ ->
        outbox
    end
  end

  defp drop_confirmed(%{oldest: oldest} = outbox)
       when oldest > outbox.last or is_map_key(outbox.entries, oldest),
       do: outbox

  defp drop_confirmed(outbox), do: drop_confirmed(%{outbox | oldest: outbox.oldest + 1})

  @doc """
  Prepares the messages for a new connection: all that were sent become waiting. Returns the identifiers that the broker
  received, for PUBREL. If the broker has lost the session, those messages are sent again, too.
  """
  @spec restart(t(), session_present? :: boolean()) :: {[id()], t()}
  def restart(outbox, session_present?) do
    entries =
      Map.new(outbox.entries, fn {n, entry} -> {n, restart_entry(entry, session_present?)} end)

    received = for {n, {_, :received, _}} <- Enum.sort(entries), do: id_of(n)
    {received, %{outbox | entries: entries, next: outbox.oldest, in_flight: length(received)}}
  end

  defp restart_entry({_, :received, _} = entry, true), do: entry
  defp restart_entry({_, :waiting, _} = entry, true), do: entry
  defp restart_entry({message, :sent, _}, true), do: {message, :waiting, true}
  defp restart_entry({message, _stage, _}, false), do: {message, :waiting, false}

  defp id_of(n), do: rem(n - 1, @ids) + 1
  defp number_of(outbox, id), do: outbox.last - Integer.mod(id_of(max(outbox.last, 1)) - id, @ids)
end
