defmodule Situ.Studio.Draw do
  @moduledoc """
  Draws the frame of a page's channel, a window or the message at the cursor, with the channel's visualizer.
  """
  alias Situ.Studio.Plugins.Guard
  alias Situ.Studio.Source.Adapted
  alias Situ.Studio.{Frame, Hole, Path, Source, Visualizer}

  @doc "Returns the frame of the window `from..to` with bins of `bin` nanoseconds."
  @spec window(
          Source.t(),
          Frame.channel(),
          Visualizer.spec(),
          Situ.Time.t(),
          Situ.Time.t(),
          pos_integer()
        ) :: Frame.t()
  def window(source, channel, %{viz: %{plugin: nil, adapter: nil}} = spec, from, to, bin),
    do: drawn(source, channel, spec, from, to, bin)

  # Code of plug-ins runs in a separate process, so that a failure affects only its panel.
  def window(source, channel, %{viz: viz} = spec, from, to, bin) do
    work = fn ->
      source |> Adapted.of(viz.adapter) |> drawn(channel, spec, from, to, bin) |> whole()
    end

    case Guard.run(work) do
      {:ok, frame} -> frame
      {:error, what} -> Frame.error(channel, blame(viz, what))
    end
  end

  # Converts a plug-in's frame to a binary here, because invalid iodata would break the reply with all frames.
  defp whole(frame), do: IO.iodata_to_binary(frame)

  defp blame(%{plugin: nil, adapter: adapter}, what), do: "#{inspect(adapter)}: #{what}"
  defp blame(%{plugin: plugin}, what), do: "the plug-in #{plugin}: #{what}"

  defp drawn(source, channel, %{viz: viz} = spec, from, to, bin) do
    if draws?(viz, :window, 6) do
      case viz.module.window(source, channel, spec, from, to, bin) do
        {:error, error} -> Frame.error(channel, error.what)
        frame -> frame
      end
    else
      Frame.error(channel, "#{inspect(viz.id)} cannot be drawn over time")
    end
  end

  @doc "Returns the frame of the message at the cursor; `last` is the state that this channel returned last."
  @spec instant(Source.t(), Frame.channel(), Visualizer.spec(), Situ.Time.t(), term()) ::
          {Frame.t(), last :: term()}
  def instant(source, channel, %{viz: %{plugin: nil, adapter: nil}} = spec, time, last),
    do: at(source, channel, spec, time, last)

  def instant(source, channel, %{viz: viz} = spec, time, last) do
    work = fn ->
      {frame, last} = source |> Adapted.of(viz.adapter) |> at(channel, spec, time, last)
      {whole(frame), last}
    end

    case Guard.run(work) do
      {:ok, answer} -> answer
      {:error, what} -> {Frame.error(channel, blame(viz, what)), nil}
    end
  end

  defp at(source, channel, %{viz: viz} = spec, time, last) do
    cond do
      draws?(viz, :value_at, 4) ->
        value_at_cursor(source, channel, spec, time, last)

      draws?(viz, :instant, 3) or draws?(viz, :instant, 4) ->
        message_at_cursor(source, channel, spec, time, last)

      true ->
        {Frame.error(channel, "#{inspect(viz.id)} cannot be drawn at the cursor"), nil}
    end
  end

  # Draws the value at the cursor of a visualizer that draws over time.
  defp value_at_cursor(source, channel, %{viz: viz} = spec, time, last) do
    case viz.module.value_at(source, channel, spec, time) do
      {:ok, ^last, _frame} -> {Frame.same(channel), last}
      {:ok, mark, frame} -> {frame, mark}
      :none when last == :none -> {Frame.same(channel), :none}
      :none -> {Frame.none(channel), :none}
      {:error, error} -> {Frame.error(channel, error.what), nil}
    end
  end

  defp message_at_cursor(source, channel, %{stream: stream} = spec, time, last) do
    {last, kept} = last || {nil, %{}}

    case message(source, stream, time, Map.get(spec, :props, %{})) do
      {:ok, %{data: %Hole{}}} ->
        {if(last == :hole, do: Frame.same(channel), else: Frame.none(channel)), {:hole, kept}}

      {:ok, message} ->
        mark = {message.originating_time, message.sequence_id}

        if mark == last do
          {Frame.same(channel), {last, kept}}
        else
          {frame, kept} = encode(source, channel, spec, message, kept)
          {frame, {mark, kept}}
        end

      :none ->
        {if(last == :none, do: Frame.same(channel), else: Frame.none(channel)), {:none, kept}}

      {:error, error} ->
        {Frame.error(channel, error.what), {nil, kept}}
    end
  end

  # Returns the last message at or before the cursor, or the nearest message within the page's `past` and `future`.
  defp message(source, stream, time, props) do
    before = Source.call(source, :latest_at, [stream, time])

    case {span(props["past"], :infinity), span(props["future"], 0)} do
      {:infinity, 0} -> before
      {past, 0} -> nearest([{before, past}], time)
      {past, future} -> nearest([{before, past}, {after_it(source, stream, time), future}], time)
    end
  end

  defp after_it(source, stream, time), do: Source.call(source, :next_after, [stream, time])

  defp span(seconds, _) when is_number(seconds) and seconds >= 0, do: round(seconds * 1.0e9)
  defp span(_, usual), do: usual

  # `away <= span` also holds for a span of `:infinity`, because atoms sort after numbers.
  defp nearest([{{:error, _} = error, _} | _], _time), do: error

  defp nearest(found, time) do
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

  defp draws?(%{module: module}, function, arity),
    do: Code.ensure_loaded?(module) and function_exported?(module, function, arity)

  # Returns the frame, and the parts of messages that the page caches after it.
  defp encode(source, channel, %{path: path} = spec, message, kept) do
    context = %{source: source, spec: spec, kept: kept}

    with {:ok, data} <- Path.fetch(message.data, path),
         {:error, what} <- frame(context, channel, data, message) do
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

  defp frame(%{spec: %{viz: %{module: module} = viz}} = context, channel, data, message) do
    if draws?(viz, :instant, 4),
      do: module.instant(channel, data, message, context),
      else: module.instant(channel, data, message)
  end
end
