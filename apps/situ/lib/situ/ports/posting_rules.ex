defmodule Situ.Ports.PostingRules do
  @moduledoc false
  # The posting rules of an output: originating times and sequence ids strictly increase, and creation times never go
  # backwards. Messages ahead of an enforced clock wait.
  alias Situ.{Error, Message}
  alias Situ.Ports.Output

  # The difference to a clock of today has to fit into 64 bits, and 9.0e18 is "never" to a stage.
  @earliest -7_000_000_000_000_000_000
  @latest 8_999_999_999_999_999_998

  @doc "Posts data at `time`; with `enforce`, the message is held until the clock reaches that time."
  @spec emit(Output.t(), Situ.Time.t(), term(), Situ.Time.t(), boolean()) ::
          {:ok, Output.t()} | {:error, Error.t()}
  def emit(%Output{closing: closing} = output, _time, _data, _now, _enforce)
      when closing != nil,
      do: {:ok, output}

  def emit(%Output{resume: until} = output, time, data, now, enforce) when is_integer(until) do
    if time <= until,
      do: {:ok, repeat(output)},
      else: emit(%{output | resume: nil}, time, data, now, enforce)
  end

  def emit(%Output{last_time: last} = output, time, data, now, enforce)
      when is_integer(last) and time <= last,
      do: output |> repeat_time(time) |> emit_again(data, now, enforce)

  def emit(%Output{future: {[], []}} = output, time, data, now, enforce)
      when not enforce or time <= now,
      do: {:ok, post(%{output | last_time: time}, time, data, now)}

  def emit(%Output{} = output, time, data, _now, _enforce),
    do: {:ok, Output.hold_item(%{output | last_time: time}, {time, data})}

  defp emit_again({:at, time, output}, data, now, enforce),
    do: emit(output, time, data, now, enforce)

  defp emit_again({:drop, output}, _data, _now, _enforce), do: {:ok, repeat(output)}
  defp emit_again({:error, error}, _data, _now, _enforce), do: {:error, error}

  # Another message at a time that has been, as the component's `on_same_time` says. One that is nudged goes 1 ns
  # behind the last; `wanted` is what time that one was to have, so that a time that really goes back is still an error.
  defp repeat_time(%{port: %{same_time: :drop}, last_time: time} = output, time),
    do: {:drop, output}

  defp repeat_time(%{port: %{same_time: :nudge}, last_time: last} = output, time) do
    wanted = with {^last, wanted} <- output.wanted, do: wanted, else: (_ -> last)

    if time >= wanted,
      do: {:at, last + 1, %{output | wanted: {last + 1, time}}},
      else: {:error, not_increasing(output, time)}
  end

  defp repeat_time(output, time), do: {:error, not_increasing(output, time)}

  @doc """
  Posts the leading `{name, time, data}` actions for this output in one pass; returns the remaining actions.
  """
  @spec emit_all(Output.t(), [tuple()], Situ.Time.t(), boolean(), integer() | nil) ::
          {:ok, Output.t(), [tuple()]} | {:error, Error.t()}
  def emit_all(
        %Output{closing: nil, future: {[], []}, resume: nil, port: %{same_time: :error}} = output,
        actions,
        now,
        false,
        nil
      ) do
    creation = if output.last_creation == nil, do: now, else: max(now, output.last_creation)
    first = output.last_time || :none
    start = {output.port.name, creation, output.port.source_id}

    case post_all(actions, start, first, output.seq, output.pending) do
      {:stuck, time, last} ->
        {:error, not_increasing(%{output | last_time: last}, time)}

      {rest, last, seq, pending} ->
        last = if last == :none, do: nil, else: last
        n = output.pending_n + seq - output.seq

        {:ok,
         %{
           output
           | last_time: last,
             last_creation: creation,
             posted: now,
             seq: seq,
             pending: pending,
             pending_n: n
         }, rest}
    end
  end

  def emit_all(output, [{_, time, _} | rest], _now, _enforce, final)
      when is_integer(final) and time > final,
      do: {:ok, output, rest}

  def emit_all(output, [{_, time, data} | rest], now, enforce, _final) do
    with {:ok, output} <- emit(output, time, data, now, enforce), do: {:ok, output, rest}
  end

  @doc "Checks that message ages from the time `first` to the last post fit the clocks and counters."
  @spec in_range(Output.t(), Situ.Time.t()) :: :ok | {:error, Error.t()}
  def in_range(%Output{last_time: last}, first)
      when first >= @earliest and (last == nil or last <= @latest),
      do: :ok

  def in_range(%Output{port: port} = output, first) do
    time = if first < @earliest, do: first, else: output.last_time

    {:error,
     Error.new(:time_out_of_range, "#{port.path} emitted a message at #{time} ns",
       why: "times are ns since 1970, from the year 1748 to the year 2255",
       fix: "scale it to ns; is it in another unit?",
       meta: %{component: port.path, time: time}
     )}
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

  @doc "Posts a message with its own envelope; only its source id is replaced by this output's."
  @spec forward(Output.t(), Message.t(), Situ.Time.t(), boolean()) ::
          {:ok, Output.t()} | {:error, Error.t()}
  def forward(%Output{closing: closing} = output, _message, _now, _enforce)
      when closing != nil,
      do: {:ok, output}

  def forward(%Output{resume: until} = output, message, now, enforce) when is_integer(until) do
    if message.originating_time <= until,
      do: {:ok, repeat(output)},
      else: forward(%{output | resume: nil}, message, now, enforce)
  end

  def forward(%Output{port: %{same_time: how}, last_time: last} = output, message, now, enforce)
      when how != :error and is_integer(last) and message.originating_time <= last do
    case repeat_time(output, message.originating_time) do
      {:at, time, output} ->
        forward(output, %{message | originating_time: time}, now, enforce)

      {:drop, output} ->
        {:ok, repeat(output)}

      error ->
        error
    end
  end

  def forward(%Output{} = output, %Message{} = message, now, enforce) do
    case check(output, message) do
      :ok when (not enforce or message.originating_time <= now) and output.future == {[], []} ->
        {:ok, push(remember(output, message), message, now)}

      :ok ->
        {:ok, Output.hold_item(remember(output, message), message)}

      error ->
        error
    end
  end

  @doc """
  Posts messages with their own envelopes, in one pass if possible. Returns `:error` if one of them is not a message.
  """
  @spec forward_all(Output.t(), [Message.t()], Situ.Time.t(), boolean()) ::
          {:ok, Output.t()} | {:error, Error.t()} | :error
  def forward_all(
        %Output{
          closing: nil,
          future: {[], []},
          resume: nil,
          port: %{same_time: :error},
          last_time: last
        } = output,
        [_, _ | _] = messages,
        now,
        false
      )
      when is_integer(last) do
    made = output.last_creation

    case push_all(messages, output.port.source_id, last, output.seq, made, nil, output.pending, 0) do
      # The first does not fit: `forward/4` says why.
      {rest, 0, _last, _pending} ->
        forward_one(output, rest, now, false)

      {rest, n, message, pending} ->
        output = remember(output, message)
        output = %{output | pending: pending, pending_n: output.pending_n + n, posted: now}
        forward_all(output, rest, now, false)
    end
  end

  def forward_all(output, [], _now, _enforce), do: {:ok, output}
  def forward_all(output, messages, now, enforce), do: forward_one(output, messages, now, enforce)

  defp forward_one(output, [%Message{} = message | rest], now, enforce) do
    with {:ok, output} <- forward(output, message, now, enforce),
         do: forward_all(output, rest, now, enforce)
  end

  defp forward_one(_output, _messages, _now, _enforce), do: :error

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
  @spec release_due(Output.t(), Situ.Time.t()) :: Output.t()
  def release_due(%Output{} = output, now) do
    case Output.pop_due(output, now) do
      nil -> output
      {held, output} -> output |> let_go(held, now) |> release_due(now)
    end
  end

  defp post(output, time, data, now) do
    creation = if output.last_creation == nil, do: now, else: max(now, output.last_creation)
    seq = output.seq + 1

    message = %Message{
      data: data,
      originating_time: time,
      creation_time: creation,
      sequence_id: seq,
      source_id: output.port.source_id
    }

    %{
      output
      | seq: seq,
        last_creation: creation,
        posted: now,
        pending: [message | output.pending],
        pending_n: output.pending_n + 1
    }
  end

  defp push(output, message, now) do
    pending = [%{message | source_id: output.port.source_id} | output.pending]
    %{output | pending: pending, pending_n: output.pending_n + 1, posted: now}
  end

  defp remember(output, message) do
    %{
      output
      | last_time: message.originating_time,
        last_creation: message.creation_time,
        seq: message.sequence_id
    }
  end

  defp repeat(output), do: %{output | repeated: output.repeated + 1}

  defp let_go(output, {time, data}, now), do: post(output, time, data, now)
  defp let_go(output, %Message{} = message, now), do: push(output, message, now)

  defp check(%{last_time: nil}, _message), do: :ok

  defp check(output, message) do
    cond do
      message.sequence_id <= output.seq ->
        {:error, out_of_order(output, :sequence, message.sequence_id)}

      message.originating_time <= output.last_time ->
        {:error, not_increasing(output, message.originating_time)}

      message.creation_time < output.last_creation ->
        {:error, out_of_order(output, :creation, message.creation_time)}

      true ->
        :ok
    end
  end

  defp not_increasing(%{port: port} = output, time) do
    Error.new(
      :time_not_increasing,
      "#{port.path}.#{port.name} emitted at #{time} ns after #{output.last_time} ns",
      why: "originating times of one output strictly increase",
      fix:
        "give each message its own, later time (equal ones: on_same_time: :drop or :nudge); in a cycle, " <>
          "delay the message",
      meta: %{component: port.path, output: port.name, time: time, last_time: output.last_time}
    )
  end

  defp out_of_order(%{port: port} = output, :sequence, id) do
    Error.new(
      :sequence_not_increasing,
      "#{port.path}.#{port.name} emitted sequence id #{id} after #{output.seq}",
      why: "sequence ids of one output strictly increase",
      meta: %{component: port.path, output: port.name, sequence_id: id, last: output.seq}
    )
  end

  defp out_of_order(%{port: port} = output, :creation, time) do
    Error.new(
      :creation_time_went_back,
      "#{port.path}.#{port.name} emitted a message created at #{time} ns " <>
        "after one created at #{output.last_creation} ns",
      why: "creation times of one output never decrease",
      meta: %{component: port.path, output: port.name, time: time, last_time: output.last_time}
    )
  end
end
