defmodule Situ.Bridge.McapRecords do
  @moduledoc """
  Builds MCAP files record by record, in every way that the format allows, and reads them again.
  It implements the specification without sharing code with the implementation under test.
  """
  @magic <<0x89, "MCAP0\r\n">>

  @features [:chunked, :indexed, :summary, :carried_indexed, :padded]

  @doc "Returns every combination of features that produces a distinct file."
  @spec variants() :: [[atom()]]
  def variants do
    for mask <- 0..31,
        chosen = for({feature, n} <- Enum.with_index(@features), bit?(mask, n), do: feature),
        :indexed not in chosen or :chunked in chosen,
        :carried_indexed not in chosen or :summary in chosen,
        do: chosen
  end

  defp bit?(mask, n), do: Bitwise.band(mask, Bitwise.bsl(1, n)) != 0

  @doc "Builds a file from its records, with three messages in each chunk."
  @spec build(map(), [atom()]) :: binary()
  def build(file, features) do
    {data, places} =
      file
      |> parts(features)
      |> Enum.map_reduce([], fn {kind, body, about}, places ->
        {{kind, body}, [{kind, byte_size(body), about} | places]}
      end)

    data = for {_, bytes} <- data, do: bytes
    head = @magic <> record(1, text(file.profile) <> text(file.library), features)
    data = IO.iodata_to_binary([head, data, record(15, <<0::32>>, features)])
    start = byte_size(data)
    summary = summary(file, offsets(Enum.reverse(places), byte_size(head)), features)
    start = if summary == "", do: 0, else: start
    # The footer is never padded, because readers find it from the end of the file.
    footer = record(2, <<start::little-64, 0::64, 0::32>>, [])
    data <> summary <> footer <> @magic
  end

  defp offsets(places, at) do
    {placed, _} =
      Enum.map_reduce(places, at, fn {kind, size, about}, at ->
        {{kind, at, size, about}, at + size}
      end)

    placed
  end

  defp parts(file, features) do
    described = schemas(file, features) <> channels(file, features)

    messages =
      if :chunked in features do
        for {part, n} <- file.messages |> Enum.chunk_every(3) |> Enum.with_index(),
            do: chunk(part, if(n == 0, do: described, else: ""), file, features)
      else
        [
          [{:described, described, nil}]
          | for(m <- file.messages, do: [{:message, message(m, features), nil}])
        ]
      end

    attachments =
      for a <- file.attachments, do: {:attachment, record(9, attachment(a), features), a}

    metadata =
      for {name, pairs} = m <- file.metadata,
          do: {:metadata, record(12, text(name) <> pairs(pairs), features), m}

    private = for {opcode, bytes} <- file.private, do: {:private, record(opcode, bytes, []), nil}
    # Attachments and private records are among the messages, as a recorder writes them.
    {first, rest} = Enum.split(messages, 2)
    Enum.concat(first) ++ attachments ++ private ++ Enum.concat(rest) ++ metadata
  end

  defp chunk(messages, described, file, features) do
    {records, index} =
      Enum.reduce(messages, {described, []}, fn m, {bytes, index} ->
        {bytes <> message(m, features), [{m.channel, m.log, byte_size(bytes)} | index]}
      end)

    times = Enum.map(messages, & &1.log)
    {name, packed} = pack(file.compression, records)

    body =
      <<Enum.min(times)::little-64, Enum.max(times)::little-64, byte_size(records)::little-64,
        :erlang.crc32(records)::little-32>> <>
        text(name) <> <<byte_size(packed)::little-64>> <> packed

    indexes =
      for {channel, rows} <- Enum.group_by(Enum.reverse(index), &elem(&1, 0)),
          :indexed in features do
        rows = for {_, time, at} <- rows, into: "", do: <<time::little-64, at::little-64>>
        {channel, record(7, <<channel::little-16, byte_size(rows)::little-32>> <> rows, features)}
      end

    about =
      {Enum.min(times), Enum.max(times), name, byte_size(packed), byte_size(records), indexes}

    [
      {:chunk, record(6, body, features), about}
      | for({_, bytes} <- indexes, do: {:index, bytes, nil})
    ]
  end

  defp pack(:none, bytes), do: {"", bytes}

  defp pack(:lz4, bytes) do
    {:ok, packed} = Situ.Bridge.Native.pack_lz4(bytes)
    {"lz4", packed}
  end

  defp summary(file, places, features) do
    if :summary in features do
      schemas(file, features) <>
        channels(file, features) <>
        statistics(file, places, features) <>
        for {kind, at, size, about} <- places,
            bytes = index(kind, at, size, about, features),
            into: "",
            do: bytes
    else
      ""
    end
  end

  defp index(:chunk, at, size, {first, last, name, packed, unpacked, indexes}, features) do
    {offsets, length} =
      Enum.map_reduce(indexes, 0, fn {channel, bytes}, length ->
        {<<channel::little-16, at + size + length::little-64>>, length + byte_size(bytes)}
      end)

    offsets = IO.iodata_to_binary(offsets)

    body =
      <<first::little-64, last::little-64, at::little-64, size::little-64,
        byte_size(offsets)::little-32>> <>
        offsets <>
        <<length::little-64>> <> text(name) <> <<packed::little-64, unpacked::little-64>>

    record(8, body, features)
  end

  defp index(:attachment, at, size, a, features) do
    if :carried_indexed in features,
      do:
        record(
          10,
          <<at::little-64, size::little-64, a.log::little-64, a.created::little-64,
            byte_size(a.data)::little-64>> <> text(a.name) <> text(a.type),
          features
        ),
      else: ""
  end

  defp index(:metadata, at, size, {name, _}, features) do
    if :carried_indexed in features,
      do: record(13, <<at::little-64, size::little-64>> <> text(name), features),
      else: ""
  end

  defp index(_kind, _at, _size, _about, _features), do: ""

  defp statistics(file, places, features) do
    counts = Enum.frequencies_by(file.messages, & &1.channel)
    counts = for {id, n} <- counts, into: "", do: <<id::little-16, n::little-64>>
    chunks = Enum.count(places, &(elem(&1, 0) == :chunk))
    times = Enum.map(file.messages, & &1.log)

    body =
      <<length(file.messages)::little-64, length(file.schemas)::little-16,
        length(file.channels)::little-32, length(file.attachments)::little-32,
        length(file.metadata)::little-32, chunks::little-32,
        Enum.min(times, fn -> 0 end)::little-64, Enum.max(times, fn -> 0 end)::little-64,
        byte_size(counts)::little-32>> <> counts

    record(11, body, features)
  end

  defp schemas(file, features) do
    for {id, name, encoding, data} <- file.schemas, into: "" do
      body =
        <<id::little-16>> <>
          text(name) <> text(encoding) <> <<byte_size(data)::little-32>> <> data

      record(3, body, features)
    end
  end

  defp channels(file, features) do
    for {id, schema, topic, encoding, metadata} <- file.channels, into: "" do
      body =
        <<id::little-16, schema::little-16>> <> text(topic) <> text(encoding) <> pairs(metadata)

      record(4, body, features)
    end
  end

  # A message's data extend to the end of the record, so it is never padded.
  defp message(m, _padded) do
    record(
      5,
      <<m.channel::little-16, m.sequence::little-32, m.log::little-64, m.publish::little-64>> <>
        m.data,
      []
    )
  end

  defp attachment(a) do
    body =
      <<a.log::little-64, a.created::little-64>> <>
        text(a.name) <> text(a.type) <> <<byte_size(a.data)::little-64>> <> a.data

    body <> <<:erlang.crc32(body)::little-32>>
  end

  defp record(opcode, body, features) do
    body = if :padded in features, do: body <> <<1, 2, 3>>, else: body
    <<opcode, byte_size(body)::little-64>> <> body
  end

  defp text(text), do: <<byte_size(text)::little-32>> <> text

  defp pairs(map) do
    bytes = for {key, value} <- Enum.sort(map), into: "", do: text(key) <> text(value)
    <<byte_size(bytes)::little-32>> <> bytes
  end

  @doc "Returns the contents of a file with its records in order, ignoring its indexes."
  @spec read(binary()) :: map()
  def read(@magic <> bytes) do
    file = %{
      schemas: [],
      channels: [],
      messages: [],
      attachments: [],
      metadata: [],
      private: []
    }

    file = take(bytes, file)

    Map.new(file, fn {key, v} ->
      {key, if(is_list(v), do: v |> Enum.reverse() |> once(), else: v)}
    end)
  end

  # A summary repeats some records.
  defp once(list), do: Enum.uniq(list)

  defp take(@magic, file), do: file

  defp take(<<opcode, size::little-64, body::binary-size(size), rest::binary>>, file),
    do: take(rest, add(opcode, body, file))

  defp take("", file), do: file

  defp add(1, body, file) do
    {profile, body} = string(body)
    {library, _} = string(body)
    Map.merge(file, %{profile: profile, library: library})
  end

  defp add(3, <<id::little-16, body::binary>>, file) do
    {name, body} = string(body)
    {encoding, <<n::little-32, data::binary-size(n), _::binary>>} = string(body)
    push(file, :schemas, {id, name, encoding, data})
  end

  defp add(4, <<id::little-16, schema::little-16, body::binary>>, file) do
    {topic, body} = string(body)
    {encoding, body} = string(body)
    push(file, :channels, {id, schema, topic, encoding, map(body)})
  end

  defp add(5, body, file) do
    <<channel::little-16, sequence::little-32, log::little-64, publish::little-64, data::binary>> =
      body

    message = %{channel: channel, sequence: sequence, log: log, publish: publish, data: data}
    push(file, :messages, message)
  end

  defp add(6, <<_times::binary-16, size::little-64, crc::little-32, body::binary>>, file) do
    {compression, <<n::little-64, packed::binary-size(n), _::binary>>} = string(body)
    {:ok, records} = Situ.Bridge.Native.unpack(compression, packed, size)
    ^crc = :erlang.crc32(records)
    take(records, file)
  end

  defp add(9, <<log::little-64, created::little-64, body::binary>>, file) do
    {name, body} = string(body)
    {type, <<n::little-64, data::binary-size(n), _crc::binary>>} = string(body)
    push(file, :attachments, %{log: log, created: created, name: name, type: type, data: data})
  end

  defp add(12, body, file) do
    {name, body} = string(body)
    push(file, :metadata, {name, map(body)})
  end

  defp add(opcode, body, file) when opcode >= 0x80, do: push(file, :private, {opcode, body})
  defp add(_index, _body, file), do: file

  defp push(file, key, value), do: Map.update!(file, key, &[value | &1])

  defp string(<<n::little-32, text::binary-size(n), rest::binary>>), do: {text, rest}

  defp map(<<n::little-32, pairs::binary-size(n), _::binary>>), do: pairs |> each([]) |> Map.new()

  defp each("", found), do: found

  defp each(bytes, found) do
    {key, bytes} = string(bytes)
    {value, bytes} = string(bytes)
    each(bytes, [{key, value} | found])
  end
end
