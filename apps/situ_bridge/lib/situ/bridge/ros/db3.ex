defmodule Situ.Bridge.Ros.Db3 do
  alias Situ.Bridge.Mcap.Codec

  @schema Codec.options()
  @moduledoc """
  Bags of ROS 2 in SQLite (`.db3`) as recordings: `Situ.Store.open("drive/drive_0.db3")`, and so in the studio,
  `bin/situ store`, replay.

  A topic is a stream, its times those of the recorder. Messages (CDR) are decoded by the definitions in the file, which
  ROS 2 writes since Iron, or else by ROS's own ones; standard ones are Situ's types (`Situ.Bridge.Ros.Standard`). Each
  file of a bag that was split is a recording. The file is read by the program `sqlite3` (Debian's package of that
  name), a process of its own, and never written.

  ## Options of opening (`Situ.Store.open(path, reader_opts: [...])`)

  #{Situ.Options.docs(@schema)}
  """
  @behaviour Situ.Store.Reader
  alias Situ.Bridge.Ros.{Definition, Library, Places}
  alias Situ.{Error, Message}
  alias Situ.Store.{StreamInfo, Undecoded}

  # Bytes of the messages of one batch.
  @most 16 * 1024 * 1024

  defstruct [:path, :name, :tracks, :streams, :notes]

  @impl true
  def extensions, do: [".db3"]

  @impl true
  def open(path, opts) do
    with {:ok, opts} <- Situ.Options.validate(opts, @schema),
         {:ok, topics} <-
           query(path, "select id, name, type, serialization_format from topics order by id"),
         {:ok, definitions} <- definitions(path),
         {:ok, rows} <- query(path, "select topic_id, timestamp, id, length(data) from messages") do
      places =
        rows |> numbers() |> Enum.group_by(&hd/1, fn [_, time, id, size] -> {time, id, size} end)

      name = Path.basename(path, ".db3")

      tracks =
        for topic <- topics, track = track(topic, definitions, places, opts[:messages]), do: track

      notes = for %{note: note} = track <- tracks, note != nil, do: "#{track.topic}: #{note}"

      {:ok,
       %__MODULE__{
         path: path,
         name: name,
         tracks: Map.new(tracks, &{&1.id, &1}),
         streams: Enum.map(tracks, &stream(&1, name, path)),
         notes: notes
       }}
    end
  end

  defp numbers(rows) do
    Enum.flat_map(rows, fn row ->
      parsed = Enum.map(row, &Integer.parse/1)
      if Enum.all?(parsed, &match?({_, ""}, &1)), do: [Enum.map(parsed, &elem(&1, 0))], else: []
    end)
  end

  # Files of before Iron have none.
  defp definitions(path) do
    there = "select name from sqlite_master where type = 'table' and name = 'message_definitions'"
    all = "select topic_type, encoding, hex(encoded_message_definition) from message_definitions"

    with {:ok, [_]} <- query(path, there), {:ok, rows} <- query(path, all) do
      {:ok,
       for(
         [type, "ros2msg", hex] <- rows,
         {:ok, text} <- [Base.decode16(hex)],
         into: %{},
         do: {type, text}
       )}
    else
      {:ok, []} -> {:ok, %{}}
      error -> error
    end
  end

  defp track([id, topic, type, format], definitions, places, messages) do
    case Integer.parse(id) do
      {id, ""} ->
        plain = Definition.plain(type)

        schema =
          case {definitions, Library.fetch(plain, :ros2)} do
            {%{^type => text}, _} when text != "" -> {type, "ros2msg", text}
            {_, {:ok, text}} -> {type, "ros2msg", text}
            _ -> nil
          end

        {codec, situ, note} = Codec.new(format, schema, topic)
        codec = Codec.shaped(codec, messages)

        places =
          Places.pack(
            for {time, at, size} <- Map.get(places, id, []),
                at >= 0,
                size >= 0,
                do: {time, at, size}
          )

        %{id: id, topic: topic, type: plain, codec: codec, situ: situ, note: note, places: places}

      _ ->
        nil
    end
  end

  defp track(_other, _definitions, _places, _messages), do: nil

  defp stream(track, name, path) do
    count = Places.count(track.places)
    {first, last} = if count > 0, do: {time(track, 0), time(track, count - 1)}, else: {nil, nil}

    %StreamInfo{
      id: track.id,
      name: track.topic,
      store_name: name,
      store_path: path,
      type: track.situ,
      type_name: track.type,
      opened: first,
      closed: last || 0,
      count: count,
      first: first,
      last: last,
      first_creation: first,
      last_creation: last
    }
  end

  defp time(track, n), do: track.places |> Places.at(n) |> elem(0)

  @doc false
  # For `Situ.Bridge.Recorder.Export`: everything that is in a message.
  def as_maps(%__MODULE__{tracks: tracks} = state) do
    maps = Map.new(tracks, fn {id, t} -> {id, %{t | codec: Codec.shaped(t.codec, :maps)}} end)
    %{state | tracks: maps}
  end

  @impl true
  def info(state) do
    created =
      state.streams |> Enum.map(& &1.first) |> Enum.reject(&is_nil/1) |> Enum.min(fn -> nil end)

    %{
      name: state.name,
      created: created,
      closed?: true,
      live?: false,
      damage: [],
      notes: state.notes
    }
  end

  @impl true
  def streams(state), do: state.streams

  @impl true
  def seek(state, info, time),
    do: {:ok, Places.seek(Map.fetch!(state.tracks, info.id).places, time)}

  @impl true
  def read(state, info, ordinal, to, limit, opts) do
    track = Map.fetch!(state.tracks, info.id)
    rows = track.places |> Places.slice(ordinal, to, limit) |> within(0)

    cond do
      rows == [] ->
        {:ok, [], ordinal}

      opts[:envelopes] ->
        {:ok, messages(rows, ordinal, track, fn _ -> nil end), ordinal + length(rows)}

      true ->
        decoded(state, track, rows, ordinal)
    end
  end

  defp within([row | rows], bytes) when bytes < @most,
    do: [row | within(rows, bytes + elem(row, 2))]

  defp within(_rows, _bytes), do: []

  defp decoded(state, track, rows, ordinal) do
    ids = Enum.map_join(rows, ",", &elem(&1, 1))

    with {:ok, found} <-
           query(state.path, "select id, hex(data) from messages where id in (#{ids})") do
      data =
        for [id, hex] <- found, {:ok, bytes} <- [Base.decode16(hex)], into: %{}, do: {id, bytes}

      {:ok, messages(rows, ordinal, track, &data(data[to_string(&1)], track.codec)),
       ordinal + length(rows)}
    end
  end

  defp messages(rows, ordinal, track, data) do
    for {{time, id, _}, n} <- Enum.with_index(rows, ordinal) do
      %Message{
        data: data.(id),
        originating_time: time,
        creation_time: time,
        sequence_id: n + 1,
        source_id: track.id
      }
    end
  end

  defp data(nil, _codec), do: %Undecoded{codec: "cdr", bytes: "", reason: "the message is gone"}

  defp data(bytes, codec) do
    case Codec.decode(codec, bytes) do
      {:ok, value} -> value
      {:error, why} -> %Undecoded{codec: "cdr", bytes: bytes, reason: why}
    end
  end

  # Rows of texts; columns and rows are parted by characters that no name has.
  defp query(path, sql) do
    with {:ok, sqlite} <- sqlite(), :ok <- there(path) do
      args = [
        "-readonly",
        "-safe",
        "-batch",
        "-noheader",
        "-list",
        "-separator",
        "\x1f",
        "-newline",
        "\x1e"
      ]

      case System.cmd(sqlite, args ++ [Path.expand(path), sql], stderr_to_stdout: true) do
        {out, 0} ->
          {:ok, for(row <- String.split(out, "\x1e", trim: true), do: String.split(row, "\x1f"))}

        {out, _} ->
          {:error,
           Error.new(:not_bag, "#{path} cannot be read as a bag of ROS 2", why: text(out))}
      end
    end
  end

  defp sqlite do
    case System.find_executable("sqlite3") do
      nil ->
        {:error,
         Error.new(:no_sqlite, "the program sqlite3 is not installed", fix: "apt install sqlite3")}

      sqlite ->
        {:ok, sqlite}
    end
  end

  defp there(path) do
    case File.stat(path) do
      {:ok, %{type: :regular}} ->
        :ok

      {:ok, _} ->
        {:error, Error.new(:not_bag, "#{path} is no file")}

      {:error, reason} ->
        {:error,
         Error.new(:io, "cannot read #{path}", why: to_string(:file.format_error(reason)))}
    end
  end

  defp text(out),
    do:
      if(String.valid?(out),
        do: out |> String.trim() |> String.slice(0, 200),
        else: "sqlite3 refuses it"
      )
end
