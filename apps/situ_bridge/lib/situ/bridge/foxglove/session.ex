defmodule Situ.Bridge.Foxglove.Session do
  @moduledoc false
  # One client, with its subscriptions and the time up to which each was served. It is not a process: `open/3`,
  # `handle_frame/3` and `tick/2` return the frames to send and the next state. `now` is a monotonic clock in
  # nanoseconds.
  alias Situ.Bridge.Foxglove.{Playback, StoreChannels, Wire}

  @protocols ["foxglove.sdk.v1", "foxglove.websocket.v1"]
  # The approximate limit of bytes sent in one tick; the playback waits for the rest.
  @max_tick_bytes 4_000_000
  @refresh_ns 1_000_000_000
  @parameters ~w(situ.paused situ.speed situ.position)

  defstruct [
    :source,
    :playback,
    :sdk?,
    :refreshed_at,
    subscriptions: %{},
    advertised_ids: MapSet.new(),
    watched_names: MapSet.new(),
    warned_ids: MapSet.new()
  ]

  @type t :: %__MODULE__{}

  @doc "Returns the supported subprotocols, the preferred one first."
  def supported_protocols, do: @protocols

  @doc "Returns the first frames for a client, and the state; `name` is the name of the server."
  @spec open(StoreChannels.t(), String.t(), protocol :: String.t()) :: {[Wire.frame()], t()}
  def open(source, name, protocol) do
    {from, to} = StoreChannels.time_range(source)
    playback = Playback.new(from, to)
    # A client that joins a live recording receives only new messages.
    playback = if source.live?, do: Playback.seek(playback, to), else: playback
    session = %__MODULE__{source: source, playback: playback, sdk?: protocol == "foxglove.sdk.v1"}
    {advertise, session} = advertise_channels(session)
    warnings = for {_, why} <- source.skipped, do: Wire.encode_status(1, why)
    {[server_info(session, name) | advertise ++ warnings], session}
  end

  defp server_info(session, name) do
    capabilities = ["time", "parameters", "parametersSubscribe"]

    members = %{
      name: name,
      supportedEncodings: [],
      metadata: %{},
      sessionId: "#{System.os_time()}"
    }

    if session.sdk? and not session.source.live?,
      do:
        Wire.encode_op(
          "serverInfo",
          Map.merge(members, %{
            capabilities: capabilities ++ ["playbackControl"],
            dataStartTime: encode_time(session.playback.from),
            dataEndTime: encode_time(session.playback.to)
          })
        ),
      else: Wire.encode_op("serverInfo", Map.put(members, :capabilities, capabilities))
  end

  defp encode_time(time),
    do: %{sec: div(max(time, 0), 1_000_000_000), nsec: rem(max(time, 0), 1_000_000_000)}

  defp advertise_channels(session) do
    new =
      for {id, {_, channel}} <- session.source.channels,
          id not in session.advertised_ids,
          do: {id, channel}

    advertised_ids = Enum.into(new, session.advertised_ids, &elem(&1, 0))

    channels =
      for {id, channel} <- Enum.sort(new), do: StoreChannels.describe_channel(id, channel)

    {if(new == [], do: [], else: [Wire.encode_op("advertise", channels: channels)]),
     %{session | advertised_ids: advertised_ids}}
  end

  @doc "Handles a frame from the client."
  @spec handle_frame(t(), {:text | :binary, binary()}, now :: integer()) :: {[Wire.frame()], t()}
  def handle_frame(session, frame, _now) do
    case Wire.parse_frame(frame) do
      {:op, op, message} -> handle_op(session, op, message)
      {:playback, command, speed, seek, id} -> control_playback(session, command, speed, seek, id)
      {:error, why} -> {[Wire.encode_status(2, why)], session}
    end
  end

  defp handle_op(session, "subscribe", %{"subscriptions" => list}) when is_list(list),
    do: collect_frames(list, session, &add_subscription/2)

  defp handle_op(session, "unsubscribe", %{"subscriptionIds" => ids}) when is_list(ids),
    do: {[], %{session | subscriptions: Map.drop(session.subscriptions, ids)}}

  defp handle_op(session, "getParameters", %{"parameterNames" => names} = message)
       when is_list(names),
       do: {[parameter_values(session, names, message)], session}

  defp handle_op(session, "setParameters", %{"parameters" => list} = message)
       when is_list(list) do
    {frames, session} = collect_frames(list, session, &set_parameter/2)
    names = for %{"name" => name} <- list, name in @parameters, do: name
    reply = if message["id"], do: [parameter_values(session, names, message)], else: []
    {frames ++ reply ++ parameter_updates(session, names), session}
  end

  defp handle_op(session, "subscribeParameterUpdates", %{"parameterNames" => names})
       when is_list(names),
       do:
         {[],
          %{session | watched_names: Enum.into(known_parameters(names), session.watched_names)}}

  defp handle_op(session, "unsubscribeParameterUpdates", %{"parameterNames" => names})
       when is_list(names),
       do:
         {[],
          %{
            session
            | watched_names:
                MapSet.difference(session.watched_names, MapSet.new(known_parameters(names)))
          }}

  defp handle_op(session, op, _message),
    do:
      {[
         Wire.encode_status(
           2,
           "#{inspect(op, limit: 50, printable_limit: 50)} is not supported, or lacks a required member"
         )
       ], session}

  defp collect_frames(list, session, fun) do
    {frames, session} = Enum.map_reduce(list, session, fun)
    {Enum.concat(frames), session}
  end

  # A new subscriber first receives the latest message at the playback's position.
  defp add_subscription(%{"id" => id, "channelId" => channel}, session)
       when is_integer(id) and id in 0..0xFFFFFFFF do
    cond do
      not is_map_key(session.source.channels, channel) ->
        {[Wire.encode_status(2, "the channel id #{inspect(channel, limit: 5)} does not exist")],
         session}

      is_map_key(session.subscriptions, id) ->
        {[Wire.encode_status(2, "the subscription id #{id} is already in use")], session}

      true ->
        at = session.playback.at
        {frames, session} = latest_frames(put_in(session.subscriptions[id], {channel, at}), id)
        {frames, session}
    end
  end

  defp add_subscription(_other, session),
    do:
      {[Wire.encode_status(2, "a subscription requires an integer `id` and a `channelId`")],
       session}

  defp latest_frames(session, id) do
    {channel, at} = session.subscriptions[id]
    session.source |> StoreChannels.latest_message(channel, at) |> message_frames(session, id)
  end

  defp message_frames(messages, session, id) do
    Enum.flat_map_reduce(messages, session, fn
      {time, {:ok, bytes}}, session -> {[Wire.encode_message(id, time, bytes)], session}
      {_time, {:error, why}}, session -> warn_once(session, id, why)
    end)
  end

  # An error is reported once per subscription, even if it repeats.
  defp warn_once(session, id, why) do
    if id in session.warned_ids,
      do: {[], session},
      else:
        {[Wire.encode_status(1, why)],
         %{session | warned_ids: MapSet.put(session.warned_ids, id)}}
  end

  # Parameters serve clients that do not support playback control.

  defp known_parameters(names), do: Enum.filter(names, &(&1 in @parameters))
  defp requested_parameters([]), do: @parameters
  defp requested_parameters(names), do: known_parameters(names)

  defp parameter_values(session, names, message) do
    id = if is_binary(message["id"]), do: %{id: message["id"]}, else: %{}

    Wire.encode_op(
      "parameterValues",
      Map.put(
        id,
        :parameters,
        for(name <- requested_parameters(names), do: parameter_value(session, name))
      )
    )
  end

  defp parameter_value(%{playback: p}, "situ.paused"),
    do: %{name: "situ.paused", value: p.paused?}

  defp parameter_value(%{playback: p}, "situ.speed"),
    do: %{name: "situ.speed", value: p.speed, type: "float64"}

  defp parameter_value(%{playback: p}, "situ.position"),
    do: %{name: "situ.position", value: max(p.at - p.from, 0) / 1.0e9, type: "float64"}

  defp set_parameter(%{"name" => "situ.paused", "value" => true}, session),
    do: apply_command(session, :pause, 0)

  defp set_parameter(%{"name" => "situ.paused", "value" => false}, session),
    do: apply_command(session, :play, 0)

  defp set_parameter(%{"name" => "situ.speed", "value" => speed}, session)
       when is_number(speed) and speed > 0,
       do: {[], update_in(session.playback, &Playback.set_speed(&1, speed))}

  defp set_parameter(%{"name" => "situ.position", "value" => s}, session)
       when is_number(s) and s >= 0 and s < 1.0e9,
       do: seek_playback(session, session.playback.from + round(s * 1.0e9))

  defp set_parameter(other, session),
    do:
      {[
         Wire.encode_status(
           2,
           "the parameter does not exist, or its value is invalid: #{inspect(other, limit: 5)}"
         )
       ], session}

  defp parameter_updates(session, names) do
    case Enum.filter(names, &(&1 in session.watched_names)) do
      [] -> []
      names -> [parameter_values(session, names, %{})]
    end
  end

  defp control_playback(%{sdk?: true} = session, command, speed, seek, id) do
    {seek_frames, session} = if seek, do: seek_playback(session, seek), else: {[], session}
    {frames, session} = apply_command(session, command, speed)
    {[playback_state(session.playback, seek != nil, id) | seek_frames ++ frames], session}
  end

  defp control_playback(session, _command, _speed, _seek, _id),
    do:
      {[Wire.encode_status(2, "playback control requires the subprotocol foxglove.sdk.v1")],
       session}

  # A playback that has ended restarts from the beginning.
  defp apply_command(session, :play, speed) do
    ended? = Playback.status(session.playback) == :ended and not session.source.live?

    {frames, session} =
      if ended?, do: seek_playback(session, session.playback.from), else: {[], session}

    {frames, update_in(session.playback, &Playback.play(&1, speed))}
  end

  defp apply_command(session, :pause, speed),
    do: {[], update_in(session.playback, &(&1 |> Playback.set_speed(speed) |> Playback.pause()))}

  defp playback_state(playback, seek?, id),
    do: Wire.encode_playback(Playback.status(playback), playback.at, playback.speed, seek?, id)

  # Every subscriber receives the latest message at the new position, and continues from there.
  defp seek_playback(session, time) do
    playback = Playback.seek(session.playback, time)

    subscriptions =
      Map.new(session.subscriptions, fn {id, {channel, _}} -> {id, {channel, playback.at}} end)

    collect_frames(
      Map.keys(subscriptions),
      %{session | playback: playback, subscriptions: subscriptions},
      &latest_frames(&2, &1)
    )
  end

  @doc """
  Returns the frames that are due: messages up to the playback's time, or all new messages of a live recording.
  """
  @spec tick(t(), now :: integer()) :: {[Wire.frame()], t()}
  def tick(session, now) do
    {channel_frames, session} = refresh_source(session, now)
    status = Playback.status(session.playback)
    playback = advance_playback(session, now)
    {messages, session} = take_due_messages(%{session | playback: playback})

    {frames, session} =
      collect_frames(messages, session, fn {_, id, message}, session ->
        message_frames([message], session, id)
      end)

    time = if status == :playing, do: [Wire.encode_time(session.playback.at)], else: []
    {channel_frames ++ frames ++ time ++ report_end(session, status), session}
  end

  defp advance_playback(%{source: %{live?: true}} = session, _now) do
    {_, to} = StoreChannels.time_range(session.source)

    %{
      session.playback
      | to: to,
        at: if(session.playback.paused?, do: session.playback.at, else: to)
    }
  end

  defp advance_playback(session, now), do: Playback.advance(session.playback, now)

  defp refresh_source(session, now) do
    if session.refreshed_at == nil or
         (session.source.live? and now - session.refreshed_at >= @refresh_ns),
       do:
         session.source
         |> StoreChannels.refresh()
         |> then(&advertise_channels(%{session | source: &1, refreshed_at: now})),
       else: {[], session}
  end

  defp report_end(%{sdk?: true} = session, :playing) do
    if Playback.status(session.playback) == :ended and not session.source.live?,
      do: [playback_state(session.playback, false, "")],
      else: []
  end

  defp report_end(_session, _before), do: []

  # Messages are sent in order of time. If there are too many, the playback advances only to the last one sent.
  defp take_due_messages(%{playback: %{at: at}} = session) do
    {lists, ends} =
      session.subscriptions
      |> Enum.map(fn {id, {channel, from}} ->
        {messages, all?} = StoreChannels.messages_between(session.source, channel, from, at)

        {Enum.map(messages, &{elem(&1, 0), id, &1}),
         if(all?, do: at, else: messages |> List.last() |> elem(0))}
      end)
      |> Enum.unzip()

    limit = Enum.min([at | ends])

    {messages, limit} =
      lists |> Enum.concat() |> Enum.sort_by(&elem(&1, 0)) |> limit_messages(limit)

    subscriptions =
      Map.new(session.subscriptions, fn {id, {channel, from}} ->
        {id, {channel, max(from, limit)}}
      end)

    playback = Playback.rewind_to(session.playback, limit)
    {messages, %{session | subscriptions: subscriptions, playback: playback}}
  end

  defp limit_messages(messages, limit) do
    messages
    |> Enum.take_while(&(elem(&1, 0) <= limit))
    |> Enum.reduce_while({[], 0, nil}, fn {time, _, {_, result}} = message,
                                          {selected, bytes, last} ->
      # Messages with the same time are sent together.
      if bytes > @max_tick_bytes and time != last,
        do: {:halt, {selected, :full, last}},
        else: {:cont, {[message | selected], bytes + message_size(result), time}}
    end)
    |> case do
      {selected, :full, last} -> {Enum.reverse(selected), last}
      {selected, _bytes, _last} -> {Enum.reverse(selected), limit}
    end
  end

  defp message_size({:ok, bytes}), do: byte_size(bytes)
  defp message_size({:error, _}), do: 0
end
