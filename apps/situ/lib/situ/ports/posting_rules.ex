defmodule Situ.Ports.PostingRules do
  @moduledoc false
  # The posting rules of an output: originating times and sequence ids strictly increase, and creation times never go
  # backwards. Messages ahead of an enforced clock wait. A closed output ignores messages.
  alias Situ.{Columns, Error, Message}
  alias Situ.Columns.Validation
  alias Situ.Ports.Output

  @compile {:inline, open_part: 3, put_posted: 3, shared_envelope?: 3}

  # The difference to a clock of today has to fit into 64 bits, and 9.0e18 is "never" to a stage.
  @earliest -7_000_000_000_000_000_000
  @latest 8_999_999_999_999_999_998

  defguardp is_closed(ending) when is_tuple(ending) and elem(ending, 1) != nil

  @doc "Posts data at `time`; with `enforce?`, the message is held until the clock reaches that time."
  @spec emit(Output.t(), Situ.Time.t(), term(), Situ.Time.t(), boolean()) ::
          {:ok, Output.t()} | {:error, Error.t()}
  def emit(%Output{ending: ending} = output, _time, _data, _now, _enforce?)
      when is_closed(ending),
      do: {:ok, output}

  def emit(%Output{} = output, time, data, now, enforce?) do
    case choose_time(output, time) do
      {:at, time, output} when output.future == {[], []} and (not enforce? or time <= now) ->
        {:ok, post(%{output | last_time: time}, time, data, now)}

      {:at, time, output} ->
        {:ok, Output.hold_item(%{output | last_time: time}, {time, data})}

      {:drop, output} ->
        {:ok, output}

      {:error, error} ->
        {:error, error}
    end
  end

  # Messages up to `resume` were posted before a restart.
  defp choose_time(%{resume: until} = output, time) when is_integer(until) do
    if time <= until,
      do: {:drop, count_repeated(output)},
      else: choose_time(%{output | resume: nil}, time)
  end

  defp choose_time(%{last_time: last} = output, time) when last == nil or time > last,
    do: {:at, time, output}

  defp choose_time(%{port: %{same_time: :drop}, last_time: time} = output, time),
    do: {:drop, count_repeated(output)}

  # A nudged message is posted 1 ns after the last one. `wanted` is the time that the last one was to have, so that a
  # time that goes back is still an error.
  defp choose_time(%{port: %{same_time: :nudge}, last_time: last} = output, time) do
    wanted = with {^last, wanted} <- output.wanted, do: wanted, else: (_ -> last)

    if time >= wanted,
      do: {:at, last + 1, %{output | wanted: {last + 1, time}}},
      else: {:error, not_increasing(output, time)}
  end

  defp choose_time(output, time), do: {:error, not_increasing(output, time)}

  defp count_repeated(output), do: %{output | repeated: output.repeated + 1}

  @doc """
  Posts the leading `{name, time, data}` actions for this output, in one pass if possible, and nothing later than
  `final`; returns the remaining actions.
  """
  @spec emit_all(Output.t(), [tuple()], Situ.Time.t(), boolean(), integer() | nil) ::
          {:ok, Output.t(), [tuple()]} | {:error, Error.t()}
  def emit_all(output, [{_, time, _} | rest], _now, _enforce?, final)
      when is_integer(final) and time > final,
      do: {:ok, output, rest}

  def emit_all(output, [{name, time, data} | rest] = actions, now, enforce?, final) do
    if shared_envelope?(output, enforce?, final) do
      post_actions(output, name, actions, now)
    else
      with {:ok, output} <- emit(output, time, data, now, enforce?), do: {:ok, output, rest}
    end
  end

  defp post_actions(output, name, [{_, time, _} | _] = actions, now) do
    created = Output.creation_time(output, now)
    {{:open, _, id, base, times, data, n}, rest} = open_part(output, created, time)

    case post_all(actions, name, base, output.last_time || :none, times, data) do
      {:stuck, time, last} ->
        {:error, not_increasing(%{output | last_time: last}, time)}

      {actions, last, times, data, posted} ->
        part = {:open, created, id, base, times, data, n + posted}
        output = put_posted(output, [part | rest], posted)

        {:ok, %{output | last_time: last, last_creation: created, seq: output.seq + posted},
         actions}
    end
  end

  @doc """
  Posts data at increasing times, two lists of the same length, and nothing later than `final`. Returns `:error` if they
  are not such lists.
  """
  @spec emit_lists(
          Output.t(),
          {[Situ.Time.t(), ...], [term()]},
          Situ.Time.t(),
          boolean(),
          integer() | nil
        ) :: {:ok, Output.t()} | {:error, Error.t()} | :error
  def emit_lists(output, {times, data}, now, enforce?, final) do
    cond do
      length(times) != length(data) or not Enum.all?(times, &is_integer/1) ->
        :error

      shared_envelope?(output, enforce?, final) ->
        post_lists(output, times, data, now)

      true ->
        times
        |> Enum.zip(data)
        |> Enum.reduce_while({:ok, output}, fn {time, value}, {:ok, output} ->
          case emit_all(output, [{output.port.name, time, value}], now, enforce?, final) do
            {:ok, output, []} -> {:cont, {:ok, output}}
            error -> {:halt, error}
          end
        end)
    end
  end

  defp post_lists(output, [base | _] = times, data, now) do
    last = :lists.last(times)
    columns = {base, relative_times(times, base, output.last_time || :none), data}
    {:ok, Output.post_results(output, last, columns, now)}
  catch
    {:situ_not_increasing, time, last} ->
      {:error, not_increasing(%{output | last_time: last}, time)}
  end

  defp relative_times([], _base, _last), do: []

  defp relative_times([time | rest], base, last) when last == :none or time > last,
    do: [time - base | relative_times(rest, base, time)]

  defp relative_times([time | _rest], _base, last), do: throw({:situ_not_increasing, time, last})

  @doc """
  Posts columns, as a whole if possible. Columns with a sequence id keep the envelopes of their messages, except for the
  source id.
  """
  @spec emit_columns(Output.t(), Columns.t(), Situ.Time.t(), boolean(), Situ.Time.t() | nil) ::
          {:ok, Output.t()} | {:error, Error.t()} | :error
  def emit_columns(output, %Columns{sequence_id: nil} = columns, now, enforce?, final) do
    if shared_envelope?(output, enforce?, final) do
      created = Output.creation_time(output, now)
      post_columns(output, %{columns | creation_times: created, sequence_id: output.seq + 1})
    else
      emit_lists(output, {Columns.times(columns), Columns.values(columns)}, now, enforce?, final)
    end
  end

  def emit_columns(output, columns, now, enforce?, _final) do
    if shared_envelope?(output, enforce?, nil) and
         Validation.continues?(columns, output.seq, output.last_creation),
       do: post_columns(output, columns),
       else: forward_all(output, Columns.messages(columns), now, enforce?)
  end

  defp post_columns(%{last_time: last} = output, columns) do
    case Validation.find_unordered(columns, last) do
      nil -> {:ok, Output.post_columns(output, columns)}
      {time, before} -> {:error, not_increasing(%{output | last_time: before}, time)}
    end
  end

  # Messages that are posted now, without looking at each: they share an envelope.
  defp shared_envelope?(
         %{future: {[], []}, resume: nil, port: %{same_time: :error}, ending: ending},
         false,
         nil
       ),
       do: not is_closed(ending)

  defp shared_envelope?(_output, _enforce?, _final), do: false

  defp post_all(actions, name, base, last, times, data),
    do: post_all(actions, name, base, last, times, data, 0)

  defp post_all([{name, time, value} | rest], name, base, last, times, data, n)
       when is_integer(time) do
    if last == :none or time > last,
      do: post_all(rest, name, base, time, [time - base | times], [value | data], n + 1),
      else: {:stuck, time, last}
  end

  defp post_all(rest, _name, _base, last, times, data, n), do: {rest, last, times, data, n}

  defp open_part(%{pending: [{:open, created, _, _, _, _, _} = part | rest]}, created, _time),
    do: {part, rest}

  defp open_part(output, created, time),
    do: {{:open, created, output.seq + 1, time, [], [], 0}, output.pending}

  defp put_posted(output, pending, n),
    do: %{output | pending: pending, pending_n: output.pending_n + n}

  defp post(output, time, data, now) do
    created = Output.creation_time(output, now)
    {{:open, _, id, base, times, all, n}, rest} = open_part(output, created, time)
    part = {:open, created, id, base, [time - base | times], [data | all], n + 1}
    put_posted(%{output | last_creation: created, seq: output.seq + 1}, [part | rest], 1)
  end

  @doc "Checks that message ages from the time `first` to the last post fit the clocks and counters."
  @spec check_range(Output.t(), Situ.Time.t()) :: :ok | {:error, Error.t()}
  def check_range(%Output{last_time: last}, first)
      when first >= @earliest and (last == nil or last <= @latest),
      do: :ok

  def check_range(%Output{port: port} = output, first) do
    time = if first < @earliest, do: first, else: output.last_time

    {:error,
     Error.new(:time_out_of_range, "#{port.path} emitted a message at #{time} ns",
       why: "times are ns since 1970, from the year 1748 to the year 2255",
       fix: "scale it to ns; is it in another unit?",
       meta: %{component: port.path, time: time}
     )}
  end

  @doc """
  Posts messages with their own envelopes, in one pass if possible; only their source id is replaced by this output's.
  Returns `:error` if one of them is not a message.
  """
  @spec forward_all(Output.t(), [Message.t()], Situ.Time.t(), boolean()) ::
          {:ok, Output.t()} | {:error, Error.t()} | :error
  def forward_all(output, [], _now, _enforce?), do: {:ok, output}

  def forward_all(%Output{ending: ending} = output, messages, _now, _enforce?)
      when is_closed(ending),
      do: if(Enum.all?(messages, &is_struct(&1, Message)), do: {:ok, output}, else: :error)

  def forward_all(
        %Output{future: {[], []}, resume: nil, port: %{same_time: :error}, last_time: last} =
          output,
        [_, _ | _] = messages,
        now,
        false
      )
      when is_integer(last) do
    {own, pending} = own_part(output)
    start = {last, output.seq, output.last_creation}

    case push_all(messages, output.port.source_id, start, own, 0) do
      # The first one does not fit: `forward/4` returns the reason.
      {rest, _own, 0} ->
        forward_first(output, rest, now, false)

      {rest, [last | _] = own, n} ->
        output = output |> remember_last(last) |> put_posted([{:own, own} | pending], n)
        forward_all(output, rest, now, false)
    end
  end

  def forward_all(output, messages, now, enforce?),
    do: forward_first(output, messages, now, enforce?)

  defp forward_first(output, [%Message{} = message | rest], now, enforce?) do
    with {:ok, output} <- forward(output, message, now, enforce?),
         do: forward_all(output, rest, now, enforce?)
  end

  defp forward_first(_output, _messages, _now, _enforce?), do: :error

  defp push_all([%Message{} = message | rest] = messages, source, {last, id, created}, own, n) do
    %{originating_time: time, sequence_id: next, creation_time: creation} = message

    if time > last and next > id and creation >= created do
      own = [%{message | source_id: source} | own]
      push_all(rest, source, {time, next, creation}, own, n + 1)
    else
      {messages, own, n}
    end
  end

  defp push_all(rest, _source, _last, own, n), do: {rest, own, n}

  defp own_part(%{pending: [{:own, messages} | rest]}), do: {messages, rest}
  defp own_part(%{pending: pending}), do: {[], pending}

  defp forward(output, message, now, enforce?) do
    with {:at, time, output} <- choose_forwarded_time(output, message),
         message = %{message | originating_time: time},
         :ok <- check_order(output, message) do
      output = remember_last(output, message)

      if output.future == {[], []} and (not enforce? or time <= now),
        do: {:ok, push(output, message)},
        else: {:ok, Output.hold_item(output, message)}
    else
      {:drop, output} -> {:ok, output}
      {:error, error} -> {:error, error}
    end
  end

  # The sequence id is checked before the time.
  defp choose_forwarded_time(%{port: %{same_time: :error}, resume: nil} = output, message),
    do: {:at, message.originating_time, output}

  defp choose_forwarded_time(%{port: %{same_time: :error}, resume: until} = output, message) do
    if message.originating_time <= until,
      do: {:drop, count_repeated(output)},
      else: {:at, message.originating_time, %{output | resume: nil}}
  end

  defp choose_forwarded_time(output, message), do: choose_time(output, message.originating_time)

  defp push(output, message) do
    {own, rest} = own_part(output)
    put_posted(output, [{:own, [%{message | source_id: output.port.source_id} | own]} | rest], 1)
  end

  defp remember_last(output, message) do
    %{
      output
      | last_time: message.originating_time,
        last_creation: message.creation_time,
        seq: message.sequence_id
    }
  end

  @doc "Releases held messages whose time has come."
  @spec release_due(Output.t(), Situ.Time.t()) :: Output.t()
  def release_due(%Output{} = output, now) do
    case Output.pop_due(output, now) do
      nil -> output
      {{time, data}, output} -> output |> post(time, data, now) |> release_due(now)
      {message, output} -> output |> push(message) |> release_due(now)
    end
  end

  defp check_order(%{last_time: nil}, _message), do: :ok

  defp check_order(output, message) do
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
