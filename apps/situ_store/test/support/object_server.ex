defmodule Situ.Store.Test.ObjectServer do
  @moduledoc false
  # A small service with the S3 interface for tests: objects in memory, ranges, versions, listings in pages, and uploads
  # in parts. Like real services, it compares bodies with their signed SHA-256. It counts requests, and a function can
  # reply with faults: `{:status, 503}`, `{:cut, bytes}`, `{:stall, bytes}`, `:corrupt` or `:hang`.
  use GenServer
  import Bitwise

  @type request :: %{
          method: String.t(),
          key: String.t(),
          query: %{String.t() => String.t()},
          headers: map(),
          body: binary()
        }
  @type fault ::
          nil | {:status, pos_integer()} | {:cut | :stall, non_neg_integer()} | :corrupt | :hang

  @spec start_link(keyword()) :: GenServer.on_start()
  def start_link(opts \\ []), do: GenServer.start_link(__MODULE__, opts)

  @doc "Returns the endpoint."
  @spec url(pid()) :: String.t()
  def url(server), do: "http://127.0.0.1:#{GenServer.call(server, :port)}"

  @doc "Sets the function that returns the fault of each request."
  @spec put_fault(pid(), (request() -> fault())) :: :ok
  def put_fault(server, fault), do: GenServer.call(server, {:put_fault, fault})

  @doc "Returns the requests since the last call, oldest first, as `{method, key}`."
  @spec take_requests(pid()) :: [{String.t(), String.t()}]
  def take_requests(server), do: GenServer.call(server, :take_requests)

  @doc "Returns the keys of all objects."
  @spec keys(pid()) :: [String.t()]
  def keys(server), do: GenServer.call(server, :keys)

  @doc "Changes an object."
  @spec put_object(pid(), String.t(), binary()) :: :ok
  def put_object(server, key, bytes), do: GenServer.call(server, {:put_object, key, bytes})

  @doc "Returns an object's bytes."
  @spec get_object(pid(), String.t()) :: binary()
  def get_object(server, key), do: GenServer.call(server, {:get_object, key})

  @impl true
  def init(opts) do
    {:ok, socket} =
      :gen_tcp.listen(0, [
        :binary,
        packet: :http_bin,
        active: false,
        ip: {127, 0, 0, 1},
        reuseaddr: true,
        backlog: 64
      ])

    server = self()
    spawn_link(fn -> accept(socket, server) end)

    {:ok,
     %{
       socket: socket,
       page: opts[:page] || 1_000,
       objects: %{},
       uploads: %{},
       requests: [],
       fault: fn _ -> nil end
     }}
  end

  @impl true
  def handle_call(:port, _from, state) do
    {:ok, port} = :inet.port(state.socket)
    {:reply, port, state}
  end

  def handle_call({:put_fault, fault}, _from, state), do: {:reply, :ok, %{state | fault: fault}}

  def handle_call(:take_requests, _from, state),
    do: {:reply, Enum.reverse(state.requests), %{state | requests: []}}

  def handle_call(:keys, _from, state),
    do: {:reply, state.objects |> Map.keys() |> Enum.sort(), state}

  def handle_call({:put_object, key, bytes}, _from, state),
    do: {:reply, :ok, put_in(state.objects[key], {etag(bytes), bytes})}

  def handle_call({:get_object, key}, _from, state),
    do: {:reply, elem(state.objects[key], 1), state}

  def handle_call({:request, request}, _from, state) do
    state = %{state | requests: [{request.method, request.key} | state.requests]}

    case state.fault.(request) do
      {:status, status} ->
        {:reply, {:ok, {status, [], error_body(status)}}, state}

      fault ->
        {response, state} = build_response(request, state)
        {:reply, {fault || :ok, response}, state}
    end
  end

  defp build_response(%{query: %{"list-type" => _}} = request, state),
    do: {list(request, state), state}

  defp build_response(%{method: "PUT", headers: headers, body: body} = request, state) do
    if headers["x-amz-content-sha256"] in [sha256(body), "UNSIGNED-PAYLOAD"],
      do: put(request, state),
      else: {{400, [], "<Error><Code>XAmzContentSHA256Mismatch</Code></Error>"}, state}
  end

  defp build_response(%{method: "POST", query: %{"uploads" => _}} = request, state) do
    id = Integer.to_string(map_size(state.uploads) + 1)

    xml =
      "<InitiateMultipartUploadResult><Bucket>b</Bucket><Key>#{request.key}</Key>" <>
        "<UploadId>#{id}</UploadId></InitiateMultipartUploadResult>"

    {{200, [], xml}, put_in(state.uploads[id], %{})}
  end

  defp build_response(%{method: "POST", query: %{"uploadId" => id}} = request, state) do
    case state.uploads do
      %{^id => parts} ->
        wanted =
          for [_, number] <- Regex.scan(~r/<PartNumber>(\d+)</, request.body),
              do: String.to_integer(number)

        bytes = Enum.map_join(wanted, &Map.fetch!(parts, &1))
        etag = etag(bytes)
        state = put_in(state.objects[request.key], {etag, bytes})

        xml =
          "<CompleteMultipartUploadResult><ETag>#{etag}</ETag></CompleteMultipartUploadResult>"

        {{200, [], xml}, %{state | uploads: Map.delete(state.uploads, id)}}

      _ ->
        {missing("NoSuchUpload"), state}
    end
  end

  defp build_response(%{method: "POST", query: %{"delete" => _}} = request, state) do
    [bucket | _] = String.split(request.key, "/")
    keys = for [_, key] <- Regex.scan(~r/<Key>([^<]*)</, request.body), do: "#{bucket}/#{key}"

    deleted = for key <- keys, do: "<Deleted><Key>#{strip(key, bucket)}</Key></Deleted>"
    xml = "<DeleteResult>#{deleted}</DeleteResult>"
    {{200, [], xml}, %{state | objects: Map.drop(state.objects, keys)}}
  end

  defp build_response(%{method: method, key: key} = request, state)
       when method in ["GET", "HEAD"] do
    case state.objects do
      %{^key => {etag, bytes}} -> {get(request, etag, bytes), state}
      _ -> {missing("NoSuchKey"), state}
    end
  end

  defp put(%{query: %{"partNumber" => number, "uploadId" => id}} = request, state) do
    if is_map_key(state.uploads, id) do
      state = put_in(state.uploads[id][String.to_integer(number)], request.body)
      {{200, [{"ETag", etag(request.body)}], ""}, state}
    else
      {missing("NoSuchUpload"), state}
    end
  end

  defp put(request, state) do
    etag = etag(request.body)
    {{200, [{"ETag", etag}], ""}, put_in(state.objects[request.key], {etag, request.body})}
  end

  # Real services repeat the key's name.
  defp error_body(403),
    do: "<Error><Code>AccessDenied</Code><AWSAccessKeyId>AKIATEST</AWSAccessKeyId></Error>"

  defp error_body(_status), do: "<Error><Code>SlowDown</Code></Error>"

  defp missing(code), do: {404, [], "<Error><Code>#{code}</Code></Error>"}

  defp get(%{headers: headers} = request, etag, bytes) do
    common = [
      {"ETag", etag},
      {"Last-Modified", "Thu, 01 Jan 2026 00:00:00 GMT"},
      {"Accept-Ranges", "bytes"}
    ]

    cond do
      headers["if-match"] not in [nil, etag] ->
        {412, [], "<Error><Code>PreconditionFailed</Code></Error>"}

      request.method == "HEAD" ->
        {200, [{"Content-Length", byte_size(bytes)} | common], ""}

      headers["range"] == nil ->
        {200, common, bytes}

      true ->
        [_, first, last] = Regex.run(~r/bytes=(\d+)-(\d+)/, headers["range"])

        {first, last} =
          {String.to_integer(first), min(String.to_integer(last), byte_size(bytes) - 1)}

        range = {"Content-Range", "bytes #{first}-#{last}/#{byte_size(bytes)}"}
        {206, [range | common], binary_part(bytes, first, last - first + 1)}
    end
  end

  # Keys begin with the bucket.
  defp list(request, state) do
    bucket = String.trim_trailing(request.key, "/")
    prefix = "#{bucket}/#{request.query["prefix"]}"
    after_key = request.query["continuation-token"] || ""

    names =
      for key <- state.objects |> Map.keys() |> Enum.sort(),
          String.starts_with?(key, prefix),
          uniq: true,
          do: fold_name(key, prefix, request.query["delimiter"])

    {page, rest} = names |> Enum.drop_while(&(&1 <= after_key)) |> Enum.split(state.page)
    {folders, keys} = Enum.split_with(page, &String.ends_with?(&1, "/"))

    contents =
      for key <- keys, {etag, bytes} = state.objects[key] do
        "<Contents><Key>#{strip(key, bucket)}</Key><Size>#{byte_size(bytes)}</Size><ETag>#{etag}</ETag>" <>
          "<LastModified>2026-01-01T00:00:00.000Z</LastModified></Contents>"
      end

    prefixes =
      for folder <- folders,
          do: "<CommonPrefixes><Prefix>#{strip(folder, bucket)}</Prefix></CommonPrefixes>"

    token =
      if rest == [],
        do: "",
        else: "<NextContinuationToken>#{List.last(page)}</NextContinuationToken>"

    {200, [],
     "<ListBucketResult>#{contents}#{prefixes}<IsTruncated>#{rest != []}</IsTruncated>#{token}</ListBucketResult>"}
  end

  defp fold_name(key, prefix, delimiter) do
    rest = binary_part(key, byte_size(prefix), byte_size(key) - byte_size(prefix))

    case delimiter && String.split(rest, delimiter, parts: 2) do
      [folder, _] -> prefix <> folder <> "/"
      _ -> key
    end
  end

  defp strip(key, bucket), do: String.replace_prefix(key, bucket <> "/", "")
  defp etag(bytes), do: ~s("#{:md5 |> :crypto.hash(bytes) |> Base.encode16(case: :lower)}")
  defp sha256(bytes), do: :sha256 |> :crypto.hash(bytes) |> Base.encode16(case: :lower)

  # Connections

  defp accept(socket, server) do
    case :gen_tcp.accept(socket) do
      {:ok, connection} ->
        pid = spawn(fn -> receive(do: (:go -> serve(connection, server))) end)
        :ok = :gen_tcp.controlling_process(connection, pid)
        send(pid, :go)
        accept(socket, server)

      {:error, _} ->
        :ok
    end
  end

  defp serve(connection, server) do
    :ok = :inet.setopts(connection, packet: :http_bin)

    with {:ok, {:http_request, method, {:abs_path, path}, _}} <- :gen_tcp.recv(connection, 0),
         {:ok, headers} <- read_headers(connection, %{}),
         :ok <- :inet.setopts(connection, packet: :raw),
         {:ok, body} <- read_body(connection, String.to_integer(headers["content-length"] || "0")) do
      uri = URI.parse(path)

      request = %{
        method: to_string(method),
        key: uri.path |> URI.decode() |> String.trim_leading("/"),
        query: URI.decode_query(uri.query || ""),
        headers: headers,
        body: body
      }

      send_response(connection, GenServer.call(server, {:request, request}, :infinity), server)
    end
  end

  defp read_headers(connection, headers) do
    case :gen_tcp.recv(connection, 0) do
      {:ok, {:http_header, _, name, _, value}} ->
        read_headers(
          connection,
          Map.put(headers, name |> to_string() |> String.downcase(), value)
        )

      {:ok, :http_eoh} ->
        {:ok, headers}

      other ->
        other
    end
  end

  defp read_body(_connection, 0), do: {:ok, ""}
  defp read_body(connection, length), do: :gen_tcp.recv(connection, length)

  defp send_response(_connection, {:hang, _}, _server), do: Process.sleep(:infinity)

  defp send_response(connection, {fault, {status, headers, body}}, server) do
    length =
      if List.keymember?(headers, "Content-Length", 0),
        do: [],
        else: [{"Content-Length", byte_size(body)}]

    lines = for {name, value} <- length ++ headers, do: "#{name}: #{value}\r\n"
    body = damage_body(fault, body)
    _ = :gen_tcp.send(connection, ["HTTP/1.1 #{status} Reply\r\n", lines, "\r\n", body])

    case fault do
      {:cut, _} -> :gen_tcp.close(connection)
      {:stall, _} -> Process.sleep(:infinity)
      _ -> serve(connection, server)
    end
  end

  defp damage_body({kind, bytes}, body) when kind in [:cut, :stall],
    do: binary_part(body, 0, min(bytes, byte_size(body)))

  defp damage_body(:corrupt, <<first, rest::binary>>), do: <<bxor(first, 1), rest::binary>>
  defp damage_body(_fault, body), do: body
end
