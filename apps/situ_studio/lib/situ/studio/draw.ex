defmodule Situ.Studio.Draw do
  @moduledoc false
  # Draws the frame of a page's channel, a window or the message at the cursor, with the channel's
  # visualizer.
  alias Situ.Studio.Plugins.Sandbox
  alias Situ.Studio.Recordings.Adapted
  alias Situ.Studio.{Frame, Gap, ValuePath, Visualizer, StreamReader}

  @doc "Returns the frame of the window `from..to` with bins of `bin` nanoseconds."
  @spec draw_window(
          Situ.Recording.t(),
          Frame.channel(),
          Visualizer.spec(),
          Situ.Time.t(),
          Situ.Time.t(),
          pos_integer()
        ) :: Frame.t()
  def draw_window(source, channel, %{viz: %{plugin: nil, adapter: nil}} = spec, from, to, bin),
    do: window_frame(source, channel, spec, from, to, bin)

  # Code of plug-ins runs in a separate process, so that a failure affects only its panel.
  def draw_window(source, channel, %{viz: viz} = spec, from, to, bin) do
    work = fn ->
      source
      |> Adapted.wrap(viz.adapter)
      |> window_frame(channel, spec, from, to, bin)
      |> flatten_frame()
    end

    case Sandbox.run(work) do
      {:ok, frame} -> frame
      {:error, what} -> Frame.error(channel, describe_failure(viz, what))
    end
  end

  # Converts a plug-in's frame to a binary here, because invalid iodata would break the reply with all frames.
  defp flatten_frame(frame), do: IO.iodata_to_binary(frame)

  defp describe_failure(%{plugin: nil, adapter: adapter}, what),
    do: "#{inspect(adapter)}: #{what}"

  defp describe_failure(%{plugin: plugin}, what), do: "the plug-in #{plugin}: #{what}"

  defp window_frame(source, channel, %{viz: viz} = spec, from, to, bin) do
    if implements?(viz, :window, 6) do
      case viz.module.window(source, channel, spec, from, to, bin) do
        {:error, error} -> Frame.error(channel, error.what)
        frame -> frame
      end
    else
      Frame.error(channel, "#{inspect(viz.id)} cannot be drawn over time")
    end
  end

  @doc "Returns the frame of the message at the cursor; `last` is the state that this channel returned last."
  @spec draw_instant(
          Situ.Recording.t(),
          Frame.channel(),
          Visualizer.spec(),
          Situ.Time.t(),
          term()
        ) ::
          {Frame.t(), last :: term()}
  def draw_instant(source, channel, %{viz: %{plugin: nil, adapter: nil}} = spec, time, last),
    do: instant_frame(source, channel, spec, time, last)

  def draw_instant(source, channel, %{viz: viz} = spec, time, last) do
    work = fn ->
      {frame, last} =
        source
        |> Adapted.wrap(viz.adapter)
        |> instant_frame(channel, spec, time, last)

      {flatten_frame(frame), last}
    end

    case Sandbox.run(work) do
      {:ok, answer} -> answer
      {:error, what} -> {Frame.error(channel, describe_failure(viz, what)), nil}
    end
  end

  defp instant_frame(source, channel, %{viz: viz} = spec, time, last) do
    cond do
      implements?(viz, :value_at, 4) ->
        value_at_cursor(source, channel, spec, time, last)

      implements?(viz, :instant, 3) or implements?(viz, :instant, 4) ->
        message_at_cursor(source, channel, spec, time, last)

      true ->
        {Frame.error(channel, "#{inspect(viz.id)} cannot be drawn at the cursor"), nil}
    end
  end

  # Draws the value at the cursor of a visualizer that draws over time.
  defp value_at_cursor(source, channel, %{viz: viz} = spec, time, last) do
    case viz.module.value_at(source, channel, spec, time) do
      {:ok, ^last, _frame} -> {Frame.same_message(channel), last}
      {:ok, mark, frame} -> {frame, mark}
      :none when last == :none -> {Frame.same_message(channel), :none}
      :none -> {Frame.no_message(channel), :none}
      {:error, error} -> {Frame.error(channel, error.what), nil}
    end
  end

  defp message_at_cursor(source, channel, %{stream: stream} = spec, time, last) do
    {last, kept} = last || {nil, %{}}

    case cursor_message(source, stream, time, Map.get(spec, :props, %{})) do
      {:ok, %{data: %Gap{}}} ->
        {if(last == :hole, do: Frame.same_message(channel), else: Frame.no_message(channel)),
         {:hole, kept}}

      {:ok, message} ->
        mark = {message.originating_time, message.sequence_id}

        if mark == last do
          {Frame.same_message(channel), {last, kept}}
        else
          {frame, kept} = encode_instant(source, channel, spec, message, kept)
          {frame, {mark, kept}}
        end

      :none ->
        {if(last == :none, do: Frame.same_message(channel), else: Frame.no_message(channel)),
         {:none, kept}}

      {:error, error} ->
        {Frame.error(channel, error.what), {nil, kept}}
    end
  end

  # Returns the last message at or before the cursor, or the nearest message within the page's `past` and `future`.
  defp cursor_message(source, stream, time, props) do
    before = StreamReader.latest_at(source, stream, time)

    case {seconds_to_ns(props["past"], :infinity), seconds_to_ns(props["future"], 0)} do
      {:infinity, 0} ->
        before

      {past, 0} ->
        nearest_message([{before, past}], time)

      {past, future} ->
        nearest_message([{before, past}, {next_message(source, stream, time), future}], time)
    end
  end

  defp next_message(source, stream, time), do: StreamReader.next_after(source, stream, time)

  defp seconds_to_ns(seconds, _) when is_number(seconds) and seconds >= 0,
    do: round(seconds * 1.0e9)

  defp seconds_to_ns(_, usual), do: usual

  # `away <= span` also holds for a span of `:infinity`, because atoms sort after numbers.
  defp nearest_message([{{:error, _} = error, _} | _], _time), do: error

  defp nearest_message(found, time) do
    near =
      for {{:ok, message}, span} <- found,
          away = abs(time - message.originating_time),
          away <= span,
          do: {away, message}

    case Enum.sort_by(near, &elem(&1, 0)) do
      [{_, message} | _] -> {:ok, message}
      [] -> :none
    end
  end

  defp implements?(%{module: module}, function, arity),
    do: Code.ensure_loaded?(module) and function_exported?(module, function, arity)

  # Returns the frame, and the parts of messages that the page caches after it.
  defp encode_instant(source, channel, %{path: path} = spec, message, kept) do
    context = %{source: source, spec: spec, kept: kept}

    with {:ok, data} <- ValuePath.fetch(message.data, path),
         {:error, what} <- call_instant(context, channel, data, message) do
      {Frame.error(channel, what), kept}
    else
      :error -> {Frame.error(channel, "this message does not have a value at this path"), kept}
      {:kept, frame, kept} -> {frame, kept}
      frame -> {frame, kept}
    end
  rescue
    # Messages come from files and external programs. Data that does not match its type shows an error in its panel,
    # and the rest of the page keeps working.
    error ->
      {Frame.error(channel, "this message cannot be drawn: #{Exception.message(error)}"), kept}
  end

  defp call_instant(%{spec: %{viz: %{module: module} = viz}} = context, channel, data, message) do
    if implements?(viz, :instant, 4),
      do: module.instant(channel, data, message, context),
      else: module.instant(channel, data, message)
  end
end
