defmodule Situ.Cluster.Log.Nats do
  @moduledoc false
  # Keeps the log of several machines and sites in NATS JetStream (a `nats-server -js`, version
  # 2.9 or newer, or a cluster).
  #
  #     {:ok, log} = Situ.Cluster.Log.connect("nats://10.0.0.1:4222,10.0.0.2:4222", replicas: 3)
  #
  # Each stream has its own JetStream stream, which its first entry creates: `SITU_S_NAME`
  # (subject `situ.s.NAME`). Characters of a name other than letters and digits are written as
  # `=HEX`, and a name of more than 200 characters as its SHA-256. All keys share one JetStream
  # stream, `SITU_KEYS` (`situ.k.NAME`, the last two messages of each). A write is conditional on
  # `Nats-Expected-Last-Sequence` or, for keys, `Nats-Expected-Last-Subject-Sequence`. The header
  # `Situ-Op` identifies the write. If the server is lost, the connection tries the servers of the
  # list in turn. Until it is connected again, all calls return `{:error, %Situ.Error{code:
  # :log_away}}`, and callers may repeat them unchanged.
  #
  # The address may contain `user:password@` or `token@`, but a file (`credentials:`) is safer. A
  # stream costs its server two open files and about 80 KB of memory. Raise the server's limit of
  # open files (`LimitNOFILE`) before you log several thousand streams.
  #
  # Options:
  # Why each stream has its own JetStream stream, with measurements:
  # see docs/adr/0113-the-log-offers-one-conditional-append.md.
  @behaviour Situ.Cluster.Log

  alias Situ.{Error, JSON, Options}
  alias Situ.Cluster.Log.Entry
  alias Situ.Cluster.Log.Nats.{Api, Subjects, Layout}
  alias Situ.Link.Nats.{Connection, Servers}

  @schema [
    replicas: [
      type: {:range, 1, 5},
      default: 1,
      doc: "The number of servers that store each entry."
    ],
    stream: [
      type: :string,
      default: "SITU",
      doc: "The prefix of the names of the JetStream streams."
    ],
    max_bytes: [
      type: :pos_integer,
      doc: "Retention limit of each stream in bytes. Beyond it, the oldest entries are deleted."
    ],
    max_age: [type: :pos_integer, doc: "Retention limit in ns. Older entries are deleted."],
    when_full: [
      type: {:in, [:drop_oldest, :refuse]},
      default: :drop_oldest,
      doc:
        "With `max_bytes`: `:refuse` returns an error (`:log_full`) instead of deleting entries."
    ],
    domain: [
      type: {:optional, :string},
      doc:
        "The JetStream domain that stores the log, such as that of a hub that the server reaches over a leaf link." <>
          " By default the connected server stores it."
    ],
    tls: [
      type: {:optional, :keyword},
      doc: "Options of `:ssl`. If given, TLS is used and the name of the server is verified."
    ],
    credentials: [
      type: {:optional, :string},
      doc:
        "A file whose first line is `user:password` or a token. Unlike an address, it does not appear in process lists."
    ],
    timeout: [type: :pos_integer, default: 2_000, doc: "How long to wait for a reply, ms."],
    wait: [
      type: :boolean,
      default: false,
      doc: "Wait for a server that is not running yet, instead of returning an error."
    ]
  ]

  @enforce_keys [:connection, :api, :stream, :timeout, :config, :prepared]
  defstruct @enforce_keys

  @typedoc """
  `api` and `stream` are the prefixes of the JetStream API subjects and of the stream names. Streams are created with
  `config`. `prepared` is 1 after the server's streams were prepared.
  """
  @type t :: %__MODULE__{
          connection: pid(),
          api: String.t(),
          stream: String.t(),
          timeout: pos_integer(),
          config: map(),
          prepared: :atomics.atomics_ref()
        }

  # Space for the headers of an entry and for those added by the server.
  @header_space 8_192

  @impl true
  def connect(address, opts) do
    with {:ok, opts} <- Options.validate(opts, @schema),
         {:ok, servers, login} <- Servers.parse(address),
         {:ok, login} <- Servers.resolve_login(login, opts[:credentials]),
         :ok <- Servers.validate_domain(opts[:domain]),
         local? = opts[:domain] == nil,
         settings = [
           servers: servers,
           login: fn -> login end,
           tls: opts[:tls],
           jetstream: local?,
           wait: opts[:wait]
         ],
         {:ok, connection} <- start_connection(settings),
         log = %__MODULE__{
           connection: connection,
           api: if(local?, do: "$JS.API.", else: "$JS.#{opts[:domain]}.API."),
           stream: opts[:stream],
           timeout: opts[:timeout],
           config: Layout.stream_config(opts),
           prepared: :atomics.new(1, [])
         },
         :ok <- log |> prepare_once() |> ignore_unreachable(opts[:wait]) do
      {:ok, log}
    end
  end

  defp ignore_unreachable({:error, %Error{code: :log_away}}, true), do: :ok
  defp ignore_unreachable(reply, _wait?), do: reply

  # The streams of the server are prepared once, at the first successful call.
  defp prepare_once(%__MODULE__{prepared: prepared} = log) do
    if :atomics.get(prepared, 1) == 1 do
      :ok
    else
      with :ok <- Layout.prepare_streams(log), do: :atomics.put(prepared, 1, 1)
    end
  end

  defp start_connection(opts) do
    case Connection.start(opts) do
      {:ok, connection} ->
        {:ok, connection}

      {:error, {:shutdown, %Error{} = error}} ->
        {:error, error}

      {:error, reason} ->
        {:error, Error.new(:log_away, "cannot connect to NATS: #{inspect(reason, limit: 5)}")}
    end
  end

  @impl true
  def append(%__MODULE__{} = log, subject, expected, %Entry{} = entry) do
    with :ok <- prepare_once(log),
         :ok <- check_size(log, entry),
         {:ok, reply} <- publish_entry(log, subject, expected, entry) do
      handle_append_reply(reply, log, subject, expected, entry)
    end
  end

  # No server replies for a stream without entries, nor during a leader election.
  defp publish_entry(log, {:stream, _} = subject, expected, entry) do
    with :silent <- request_append(log, subject, expected, entry),
         stream = stream_name(log, subject),
         {:error, %Error{code: :no_stream}} <-
           Api.stream_info(log, stream, info_timeout(log, expected)),
         config = %{"name" => stream, "subjects" => [subject_name(subject)]},
         :ok <- Api.create_stream(log, Map.merge(log.config, config)) do
      log |> request_append(subject, expected, entry) |> Api.reject_silence()
    else
      # The stream exists, but currently has no leader.
      {:ok, %{"config" => _}} -> Api.reject_silence(:silent)
      reply -> reply
    end
  end

  defp publish_entry(log, subject, expected, entry),
    do: log |> request_append(subject, expected, entry) |> Api.reject_silence()

  # A stream that had entries most likely still exists. Waiting too long during a leader election would lose the reply.
  defp info_timeout(log, 0), do: log.timeout
  defp info_timeout(log, _expected), do: max(div(log.timeout, 8), 1)

  defp request_append(log, subject, expected, entry) do
    headers =
      [{condition_header(subject), Integer.to_string(expected)}, {"Situ-Op", entry.op}] ++
        for({key, value} <- entry.head, do: {"Situ-" <> key, value})

    Api.try_request(log, subject_name(subject), headers, entry.data, log.timeout)
  end

  defp condition_header({:stream, _}), do: "Nats-Expected-Last-Sequence"
  defp condition_header({:key, _}), do: "Nats-Expected-Last-Subject-Sequence"

  # Another writer was faster, or this is a repetition of a write whose acknowledgement was lost.
  defp handle_append_reply(%{"error" => %{"err_code" => 10_071}}, log, subject, expected, %{
         op: op
       }) do
    case last(log, subject) do
      {:ok, %Entry{op: ^op, seq: seq}} -> {:ok, seq}
      {:ok, nil} when expected == 0 -> find_last_number(log, subject)
      {:ok, last} -> {:refused, last}
      {:error, error} -> {:error, error}
    end
  end

  defp handle_append_reply(%{"error" => error}, _log, _subject, _expected, _entry),
    do: {:error, Api.server_error(error)}

  defp handle_append_reply(%{"seq" => seq}, _log, _subject, _expected, _entry) when seq > 0,
    do: {:ok, seq}

  defp handle_append_reply(_answer, _log, _subject, _expected, _entry),
    do: {:error, Api.unreachable_error("the reply is incomplete")}

  # All its entries have expired, so the stream is empty, but its numbers continue.
  defp find_last_number(log, subject) do
    with {:ok, %{"state" => %{"last_seq" => seq}}} when seq > 0 <-
           Api.stream_info(log, stream_name(log, subject)) do
      {:counts_from, seq}
    else
      {:error, error} -> {:error, error}
      _ -> {:refused, nil}
    end
  end

  defp check_size(log, entry) do
    size = :erlang.iolist_size(entry.data)

    if size <= limit(log),
      do: :ok,
      else:
        {:error,
         Error.new(
           :too_large,
           "the entry has #{size} bytes, but the server accepts at most #{limit(log)}",
           why: "the server closes the connection if a message is too large",
           fix: "raise max_payload in the server's configuration, or write smaller entries"
         )}
  end

  # Asks the leader of the stream, because a replica may not have the entry yet.
  @impl true
  def last(%__MODULE__{} = log, subject),
    do: fetch_message(log, subject, %{"last_by_subj" => subject_name(subject)})

  @impl true
  def first(%__MODULE__{} = log, subject, from),
    do: fetch_message(log, subject, %{"seq" => from, "next_by_subj" => subject_name(subject)})

  defp fetch_message(log, subject, query) do
    body = JSON.encode(query)

    with :ok <- prepare_once(log),
         {:ok, reply} <-
           Api.request_json(log, log.api <> "STREAM.MSG.GET." <> stream_name(log, subject), body),
         do: decode_reply(reply)
  end

  defp decode_reply(%{"message" => message}), do: decode_message(message)

  defp decode_reply(%{"error" => %{"err_code" => code}}) when code in [10_037, 10_059],
    do: {:ok, nil}

  defp decode_reply(%{"error" => error}), do: {:error, Api.server_error(error)}
  defp decode_reply(_other), do: {:error, Api.unreachable_error("the reply is incomplete")}

  defp decode_message(message) do
    with {:ok, head} <- Base.decode64(message["hdrs"] || ""),
         {:ok, data} <- Base.decode64(message["data"] || "") do
      headers =
        for line <- String.split(head, "\r\n"),
            [key, value] <- [String.split(line, ": ", parts: 2)],
            into: %{},
            do: {key, value}

      {:ok, build_entry(headers, data, message["seq"])}
    else
      _ -> {:error, Api.unreachable_error("the reply is not valid Base64")}
    end
  end

  defp build_entry(headers, data, seq) do
    {op, headers} = Map.pop(headers, "Situ-Op", "")
    head = for {"Situ-" <> key, value} <- headers, into: %{}, do: {key, value}
    %Entry{seq: seq, op: op, head: head, data: data}
  end

  @impl true
  def read(%__MODULE__{} = log, {:stream, _} = subject, 1, max) do
    # The server does not reply to direct reads of a stream that does not exist.
    case Api.stream_info(log, stream_name(log, subject)) do
      {:ok, _info} -> read_entries(log, subject, 1, max, [])
      {:error, %Error{code: :no_stream}} -> {:ok, []}
      {:error, error} -> {:error, error}
    end
  end

  def read(%__MODULE__{} = log, subject, from, max),
    do: read_entries(log, subject, from, max, [])

  defp read_entries(_log, _subject, _from, 0, entries), do: {:ok, Enum.reverse(entries)}

  defp read_entries(log, subject, from, max, entries) do
    body = JSON.encode(%{"seq" => from, "next_by_subj" => subject_name(subject)})
    target = log.api <> "DIRECT.GET." <> stream_name(log, subject)

    case Connection.request(log.connection, target, [], body, log.timeout) do
      {:ok, %{status: status}} when status in ["404", "408"] ->
        {:ok, Enum.reverse(entries)}

      {:ok, %{status: "503"}} ->
        {:error, Api.unreachable_error("JetStream is not responding")}

      {:ok, %{headers: %{"Nats-Sequence" => seq} = headers, data: data}} ->
        entry = build_entry(headers, data, String.to_integer(seq))
        read_entries(log, subject, entry.seq + 1, max - 1, [entry | entries])

      {:ok, _other} ->
        {:error, Api.unreachable_error("the reply is incomplete")}

      {:error, reason} ->
        {:error, Api.unreachable_error(reason)}
    end
  end

  @impl true
  def trim(%__MODULE__{} = log, subject, seq) do
    with {:ok, %Entry{} = last} <- last(log, subject) do
      body = JSON.encode(Map.put(purge_filter(subject), "seq", min(seq, last.seq)))

      case Api.request_json(log, log.api <> "STREAM.PURGE." <> stream_name(log, subject), body) do
        {:ok, %{"success" => true}} -> :ok
        {:ok, %{"error" => error}} -> {:error, Api.server_error(error)}
        {:ok, _} -> {:error, Api.unreachable_error("the reply is incomplete")}
        {:error, error} -> {:error, error}
      end
    else
      {:ok, nil} -> :ok
      error -> error
    end
  end

  defp purge_filter({:stream, _}), do: %{}
  defp purge_filter(subject), do: %{"filter" => subject_name(subject)}

  @impl true
  def subjects(%__MODULE__{} = log),
    do: Subjects.list_subjects(log, log.stream <> "_S_", log.stream <> "_KEYS")

  @impl true
  def delete(%__MODULE__{} = log, {:stream, _} = subject),
    do: Subjects.delete_stream(log, stream_name(log, subject))

  def delete(%__MODULE__{} = log, subject),
    do: Subjects.purge_subject(log, stream_name(log, subject), subject_name(subject))

  @impl true
  def limit(%__MODULE__{} = log) do
    payload = (Connection.server_info(log.connection) || %{})["max_payload"] || 1_048_576
    max(payload - @header_space, 1_024)
  end

  @impl true
  def close(%__MODULE__{} = log) do
    GenServer.stop(log.connection)
  catch
    :exit, _ -> :ok
  end

  defp stream_name(log, {:stream, name}),
    do: log.stream <> "_S_" <> shorten_token(encode_token(name))

  defp stream_name(log, {:key, _}), do: log.stream <> "_KEYS"

  # A name becomes a single token, so that its characters cannot change the structure of the subject.
  defp subject_name({:stream, name}), do: "situ.s." <> encode_token(name)
  defp subject_name({:key, name}), do: "situ.k." <> encode_token(name)

  # The name of a JetStream stream is also a folder name, limited to 255 characters.
  defp shorten_token(token) when byte_size(token) <= 200, do: String.replace(token, "%", "=")
  defp shorten_token(token), do: Base.encode16(:crypto.hash(:sha256, token), case: :lower)

  defp encode_token(name) do
    URI.encode(name, fn c -> c in ?a..?z or c in ?A..?Z or c in ?0..?9 or c in [?_, ?-] end)
  end
end
