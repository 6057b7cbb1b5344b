defmodule Situ.Stage.Posting do
  @moduledoc false
  # The posting rules of an output: originating times and sequence ids strictly increase, creation times do not go back; what
  # is ahead of an enforced clock waits.
  alias Situ.{Error, Message}
  alias Situ.Stage.{Disorder, Outlet}

  @doc "Posts data at `time`; held back until the clock reaches it when `enforce`d."
  @spec emit(Outlet.t(), Situ.Time.t(), term(), Situ.Time.t(), boolean()) ::
          {:ok, Outlet.t()} | {:error, Error.t()}
  def emit(%Outlet{closing: closing} = outlet, _time, _data, _now, _enforce)
      when closing != nil,
      do: {:ok, outlet}

  def emit(%Outlet{resume: until} = outlet, time, data, now, enforce) when is_integer(until) do
    if time <= until,
      do: {:ok, repeat(outlet)},
      else: emit(%{outlet | resume: nil}, time, data, now, enforce)
  end

  def emit(%Outlet{last_time: last} = outlet, time, data, now, enforce)
      when is_integer(last) and time <= last,
      do: outlet |> again(time) |> emit_again(data, now, enforce)

  def emit(%Outlet{future: []} = outlet, time, data, now, enforce)
      when not enforce or time <= now,
      do: {:ok, post(%{outlet | last_time: time}, time, data, now)}

  def emit(%Outlet{} = outlet, time, data, _now, _enforce),
    do: {:ok, hold(%{outlet | last_time: time}, {time, data})}

  defp emit_again({:at, time, outlet}, data, now, enforce),
    do: emit(outlet, time, data, now, enforce)

  defp emit_again({:drop, outlet}, _data, _now, _enforce), do: {:ok, repeat(outlet)}
  defp emit_again({:error, error}, _data, _now, _enforce), do: {:error, error}

  # Another message at a time that has been, as the component's `on_same_time` says. One that is nudged goes 1 ns behind the
  # last; `wanted` is what time that one was to have, so that a time that really goes back is still an error.
  defp again(%{same_time: :drop, last_time: time} = outlet, time), do: {:drop, outlet}

  defp again(%{same_time: :nudge, last_time: last} = outlet, time) do
    wanted = with {^last, wanted} <- outlet.wanted, do: wanted, else: (_ -> last)

    if time >= wanted,
      do: {:at, last + 1, %{outlet | wanted: {last + 1, time}}},
      else: {:error, Disorder.not_increasing(outlet, time)}
  end

  defp again(outlet, time), do: {:error, Disorder.not_increasing(outlet, time)}

  @doc """
  Posts the leading `{name, time, data}` actions that are for this output, in one go; answers the actions left over.
  """
  @spec emit_all(Outlet.t(), [tuple()], Situ.Time.t(), boolean(), integer() | nil) ::
          {:ok, Outlet.t(), [tuple()]} | {:error, Error.t()}
  def emit_all(
        %Outlet{closing: nil, future: [], resume: nil, same_time: :error} = outlet,
        actions,
        now,
        false,
        nil
      ) do
    creation = if outlet.last_creation == nil, do: now, else: max(now, outlet.last_creation)
    first = outlet.last_time || :none
    start = {outlet.name, creation, outlet.source_id}

    case post_all(actions, start, first, outlet.seq, outlet.pending) do
      {:stuck, time, last} ->
        {:error, Disorder.not_increasing(%{outlet | last_time: last}, time)}

      {rest, last, seq, pending} ->
        last = if last == :none, do: nil, else: last
        n = outlet.pending_n + seq - outlet.seq

        {:ok,
         %{
           outlet
           | last_time: last,
             last_creation: creation,
             posted: now,
             seq: seq,
             pending: pending,
             pending_n: n
         }, rest}
    end
  end

  def emit_all(outlet, [{_, time, _} | rest], _now, _enforce, final)
      when is_integer(final) and time > final,
      do: {:ok, outlet, rest}

  def emit_all(outlet, [{_, time, data} | rest], now, enforce, _final) do
    with {:ok, outlet} <- emit(outlet, time, data, now, enforce), do: {:ok, outlet, rest}
  end

  defp post_all([{name, time, data} | rest], {name, creation, id} = start, last, seq, pending)
       when is_integer(time) do
    if time > last or last == :none do
      seq = seq + 1

      message = %Message{
        data: data,
        originating_time: time,
        creation_time: creation,
        sequence_id: seq,
        source_id: id
      }

      post_all(rest, start, time, seq, [message | pending])
    else
      {:stuck, time, last}
    end
  end

  defp post_all(rest, _start, last, seq, pending), do: {rest, last, seq, pending}

  @doc "Posts a message with its own envelope; only the source id becomes this output's."
  @spec forward(Outlet.t(), Message.t(), Situ.Time.t(), boolean()) ::
          {:ok, Outlet.t()} | {:error, Error.t()}
  def forward(%Outlet{closing: closing} = outlet, _message, _now, _enforce)
      when closing != nil,
      do: {:ok, outlet}

  def forward(%Outlet{resume: until} = outlet, message, now, enforce) when is_integer(until) do
    if message.originating_time <= until,
      do: {:ok, repeat(outlet)},
      else: forward(%{outlet | resume: nil}, message, now, enforce)
  end

  def forward(%Outlet{same_time: how, last_time: last} = outlet, message, now, enforce)
      when how != :error and is_integer(last) and message.originating_time <= last do
    case again(outlet, message.originating_time) do
      {:at, time, outlet} ->
        forward(outlet, %{message | originating_time: time}, now, enforce)

      {:drop, outlet} ->
        {:ok, repeat(outlet)}

      error ->
        error
    end
  end

  def forward(%Outlet{} = outlet, %Message{} = message, now, enforce) do
    case check(outlet, message) do
      :ok when (not enforce or message.originating_time <= now) and outlet.future == [] ->
        {:ok, push(remember(outlet, message), message, now)}

      :ok ->
        {:ok, hold(remember(outlet, message), message)}

      error ->
        error
    end
  end

  @doc """
  Posts messages with their own envelopes, in one go where nothing stands in the way. `:error` when one of them is no message.
  """
  @spec forward_all(Outlet.t(), [Message.t()], Situ.Time.t(), boolean()) ::
          {:ok, Outlet.t()} | {:error, Error.t()} | :error
  def forward_all(
        %Outlet{closing: nil, future: [], resume: nil, same_time: :error, last_time: last} =
          outlet,
        [_, _ | _] = messages,
        now,
        false
      )
      when is_integer(last) do
    made = outlet.last_creation

    case push_all(messages, outlet.source_id, last, outlet.seq, made, nil, outlet.pending, 0) do
      # The first does not fit: `forward/4` says why.
      {rest, 0, _last, _pending} ->
        forward_one(outlet, rest, now, false)

      {rest, n, message, pending} ->
        outlet = remember(outlet, message)
        outlet = %{outlet | pending: pending, pending_n: outlet.pending_n + n, posted: now}
        forward_all(outlet, rest, now, false)
    end
  end

  def forward_all(outlet, [], _now, _enforce), do: {:ok, outlet}
  def forward_all(outlet, messages, now, enforce), do: forward_one(outlet, messages, now, enforce)

  defp forward_one(outlet, [%Message{} = message | rest], now, enforce) do
    with {:ok, outlet} <- forward(outlet, message, now, enforce),
         do: forward_all(outlet, rest, now, enforce)
  end

  defp forward_one(_outlet, _messages, _now, _enforce), do: :error

  defp push_all(
         [
           %Message{originating_time: time, sequence_id: id, creation_time: created} = message
           | rest
         ],
         source,
         last,
         seq,
         made,
         _previous,
         pending,
         n
       )
       when time > last and id > seq and created >= made do
    pending = [%{message | source_id: source} | pending]
    push_all(rest, source, time, id, created, message, pending, n + 1)
  end

  defp push_all(rest, _source, _last, _seq, _made, message, pending, n),
    do: {rest, n, message, pending}

  @doc "Releases held messages whose time has come."
  @spec release(Outlet.t(), Situ.Time.t()) :: Outlet.t()
  def release(%Outlet{future: []} = outlet, _now), do: outlet

  def release(%Outlet{future: [first | rest]} = outlet, now) do
    if Outlet.time_of(first) <= now do
      outlet = if rest == [], do: turn(outlet), else: %{outlet | future: rest}
      outlet |> let_go(first, now) |> release(now)
    else
      outlet
    end
  end

  defp post(outlet, time, data, now) do
    creation = if outlet.last_creation == nil, do: now, else: max(now, outlet.last_creation)
    seq = outlet.seq + 1

    message = %Message{
      data: data,
      originating_time: time,
      creation_time: creation,
      sequence_id: seq,
      source_id: outlet.source_id
    }

    %{
      outlet
      | seq: seq,
        last_creation: creation,
        posted: now,
        pending: [message | outlet.pending],
        pending_n: outlet.pending_n + 1
    }
  end

  defp push(outlet, message, now) do
    pending = [%{message | source_id: outlet.source_id} | outlet.pending]
    %{outlet | pending: pending, pending_n: outlet.pending_n + 1, posted: now}
  end

  defp remember(outlet, message) do
    %{
      outlet
      | last_time: message.originating_time,
        last_creation: message.creation_time,
        seq: message.sequence_id
    }
  end

  defp repeat(outlet), do: %{outlet | repeated: outlet.repeated + 1}

  defp hold(%{future: []} = outlet, item), do: %{outlet | future: [item]}
  defp hold(outlet, item), do: %{outlet | future_rear: [item | outlet.future_rear]}

  defp turn(outlet), do: %{outlet | future: Enum.reverse(outlet.future_rear), future_rear: []}

  defp let_go(outlet, {time, data}, now), do: post(outlet, time, data, now)
  defp let_go(outlet, %Message{} = message, now), do: push(outlet, message, now)

  defp check(%{last_time: nil}, _message), do: :ok

  defp check(outlet, message) do
    cond do
      message.sequence_id <= outlet.seq ->
        {:error, Disorder.bad_sequence(outlet, message.sequence_id)}

      message.originating_time <= outlet.last_time ->
        {:error, Disorder.not_increasing(outlet, message.originating_time)}

      message.creation_time < outlet.last_creation ->
        {:error, Disorder.bad_creation(outlet, message.creation_time)}

      true ->
        :ok
    end
  end
end
