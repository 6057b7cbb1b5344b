defmodule Situ.Remote.Log.Nats do
  @moduledoc """
  The log of several machines and sites: NATS JetStream (a `nats-server -js`, version 2.9 or newer, or a cluster).

      {:ok, log} = Situ.Remote.Log.connect("nats://10.0.0.1:4222,10.0.0.2:4222", replicas: 3)

  Each stream has its own JetStream stream, which its first entry creates: `SITU_S_NAME` (subject `situ.s.NAME`).
  Characters of a name other than letters and digits are written as `=HEX`, and a name of more than 200 characters as
  its SHA-256. All keys share one JetStream stream, `SITU_KEYS` (`situ.k.NAME`, the last two messages of each). A write
  is conditional on `Nats-Expected-Last-Sequence` or, for keys, `Nats-Expected-Last-Subject-Sequence`. The header
  `Situ-Op` identifies the write. If the server is lost, the connection tries the servers of the list in turn. Until it
  is connected again, all calls return `{:error, %Situ.Error{code: :log_away}}`, and callers may repeat them unchanged.

  The address may contain `user:password@` or `token@`, but a file (`credentials:`) is safer. A stream costs its server
  two open files and about 80 KB of memory (ADR 0118). Raise the server's limit of open files (`LimitNOFILE`) before you
  log several thousand streams.

  ## Options

  """
  @behaviour Situ.Remote.Log

  alias Situ.{Error, JSON, Options}
  alias Situ.Remote.Log.Entry
  alias Situ.Remote.Log.Nats.{Api, Connection, Kept, Layout, Servers}

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
      doc: "Retention limit of each stream in bytes: the oldest entries are deleted beyond it ..."
    ],
    max_age: [type: :pos_integer, doc: "... or when they are older than this, ns."],
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
  @moduledoc @moduledoc <> Options.docs(@schema)

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
  @reserve 8_192

  @impl true
  def connect(address, opts) do
    with {:ok, opts} <- Options.validate(opts, @schema),
         {:ok, servers, login} <- Servers.parse(address),
         {:ok, login} <- Servers.login(login, opts[:credentials]),
         :ok <- Servers.domain(opts[:domain]),
         own? = opts[:domain] == nil,
         settings = [
           servers: servers,
           login: fn -> login end,
           tls: opts[:tls],
           jetstream: own?,
           wait: opts[:wait]
         ],
         {:ok, connection} <- start(settings),
         log = %__MODULE__{
           connection: connection,
           api: if(own?, do: "$JS.API.", else: "$JS.#{opts[:domain]}.API."),
           stream: opts[:stream],
           timeout: opts[:timeout],
           config: Layout.config(opts),
           prepared: :atomics.new(1, [])
         },
         :ok <- log |> prepare_once() |> allow_away(opts[:wait]) do
      {:ok, log}
    end
  end

  defp allow_away({:error, %Error{code: :log_away}}, true), do: :ok
  defp allow_away(answer, _wait?), do: answer

  # The streams of the server are prepared once, at the first successful call.
  defp prepare_once(%__MODULE__{prepared: prepared} = log) do
    if :atomics.get(prepared, 1) == 1 do
      :ok
    else
      with :ok <- Layout.prepare(log), do: :atomics.put(prepared, 1, 1)
    end
  end

  defp start(opts) do
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
         :ok <- fits(log, entry),
         {:ok, answer} <- publish(log, subject, expected, entry) do
      appended(answer, log, subject, expected, entry)
    end
  end

  # No server replies for a stream without entries, nor during a leader election.
  defp publish(log, {:stream, _} = subject, expected, entry) do
    with :silent <- published(log, subject, expected, entry),
         stream = stream(log, subject),
         {:error, %Error{code: :no_stream}} <- Api.info(log, stream, soon(log, expected)),
         config = %{"name" => stream, "subjects" => [name(subject)]},
         :ok <- Api.made(log, Map.merge(log.config, config)) do
      log |> published(subject, expected, entry) |> Api.heard()
    else
      # The stream exists, but currently has no leader.
      {:ok, %{"config" => _}} -> Api.heard(:silent)
      answer -> answer
    end
  end

  defp publish(log, subject, expected, entry),
    do: log |> published(subject, expected, entry) |> Api.heard()

  # A stream that had entries most likely still exists. Waiting too long during a leader election would lose the reply.
  defp soon(log, 0), do: log.timeout
  defp soon(log, _expected), do: max(div(log.timeout, 8), 1)

  defp published(log, subject, expected, entry) do
    headers =
      [{condition(subject), Integer.to_string(expected)}, {"Situ-Op", entry.op}] ++
        for({key, value} <- entry.head, do: {"Situ-" <> key, value})

    Api.answer(log, name(subject), headers, entry.data, log.timeout)
  end

  defp condition({:stream, _}), do: "Nats-Expected-Last-Sequence"
  defp condition({:key, _}), do: "Nats-Expected-Last-Subject-Sequence"

  # Another writer was faster, or this is a repetition of a write whose acknowledgement was lost.
  defp appended(%{"error" => %{"err_code" => 10_071}}, log, subject, expected, %{op: op}) do
    case last(log, subject) do
      {:ok, %Entry{op: ^op, seq: seq}} -> {:ok, seq}
      {:ok, nil} when expected == 0 -> find_last_number(log, subject)
      {:ok, last} -> {:refused, last}
      {:error, error} -> {:error, error}
    end
  end

  defp appended(%{"error" => error}, _log, _subject, _expected, _entry),
    do: {:error, Api.refusal(error)}

  defp appended(%{"seq" => seq}, _log, _subject, _expected, _entry) when seq > 0, do: {:ok, seq}

  defp appended(_answer, _log, _subject, _expected, _entry),
    do: {:error, Api.away("the reply is incomplete")}

  # All its entries have expired, so the stream is empty, but its numbers continue.
  defp find_last_number(log, subject) do
    with {:ok, %{"state" => %{"last_seq" => seq}}} when seq > 0 <-
           Api.info(log, stream(log, subject)) do
      {:counts_from, seq}
    else
      {:error, error} -> {:error, error}
      _ -> {:refused, nil}
    end
  end

  defp fits(log, entry) do
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
    do: get(log, subject, %{"last_by_subj" => name(subject)})

  @impl true
  def first(%__MODULE__{} = log, subject, from),
    do: get(log, subject, %{"seq" => from, "next_by_subj" => name(subject)})

  defp get(log, subject, question) do
    body = JSON.encode(question)

    with :ok <- prepare_once(log),
         {:ok, answer} <-
           Api.ask(log, log.api <> "STREAM.MSG.GET." <> stream(log, subject), body),
         do: message(answer)
  end

  defp message(%{"message" => message}), do: decoded(message)
  defp message(%{"error" => %{"err_code" => code}}) when code in [10_037, 10_059], do: {:ok, nil}
  defp message(%{"error" => error}), do: {:error, Api.refusal(error)}
  defp message(_other), do: {:error, Api.away("the reply is incomplete")}

  defp decoded(message) do
    with {:ok, head} <- Base.decode64(message["hdrs"] || ""),
         {:ok, data} <- Base.decode64(message["data"] || "") do
      headers =
        for line <- String.split(head, "\r\n"),
            [key, value] <- [String.split(line, ": ", parts: 2)],
            into: %{},
            do: {key, value}

      {:ok, entry(headers, data, message["seq"])}
    else
      _ -> {:error, Api.away("the reply is not valid Base64")}
    end
  end

  defp entry(headers, data, seq) do
    {op, headers} = Map.pop(headers, "Situ-Op", "")
    head = for {"Situ-" <> key, value} <- headers, into: %{}, do: {key, value}
    %Entry{seq: seq, op: op, head: head, data: data}
  end

  @impl true
  def read(%__MODULE__{} = log, {:stream, _} = subject, 1, most) do
    # The server does not reply to direct reads of a stream that does not exist.
    case Api.info(log, stream(log, subject)) do
      {:ok, _info} -> read(log, subject, 1, most, [])
      {:error, %Error{code: :no_stream}} -> {:ok, []}
      {:error, error} -> {:error, error}
    end
  end

  def read(%__MODULE__{} = log, subject, from, most), do: read(log, subject, from, most, [])

  defp read(_log, _subject, _from, 0, entries), do: {:ok, Enum.reverse(entries)}

  defp read(log, subject, from, most, entries) do
    body = JSON.encode(%{"seq" => from, "next_by_subj" => name(subject)})
    target = log.api <> "DIRECT.GET." <> stream(log, subject)

    case Connection.request(log.connection, target, [], body, log.timeout) do
      {:ok, %{status: status}} when status in ["404", "408"] ->
        {:ok, Enum.reverse(entries)}

      {:ok, %{status: "503"}} ->
        {:error, Api.away("JetStream is not responding")}

      {:ok, %{headers: %{"Nats-Sequence" => seq} = headers, data: data}} ->
        entry = entry(headers, data, String.to_integer(seq))
        read(log, subject, entry.seq + 1, most - 1, [entry | entries])

      {:ok, _other} ->
        {:error, Api.away("the reply is incomplete")}

      {:error, reason} ->
        {:error, Api.away(reason)}
    end
  end

  @impl true
  def trim(%__MODULE__{} = log, subject, seq) do
    with {:ok, %Entry{} = last} <- last(log, subject) do
      body = JSON.encode(Map.put(filter(subject), "seq", min(seq, last.seq)))

      case Api.ask(log, log.api <> "STREAM.PURGE." <> stream(log, subject), body) do
        {:ok, %{"success" => true}} -> :ok
        {:ok, %{"error" => error}} -> {:error, Api.refusal(error)}
        {:ok, _} -> {:error, Api.away("the reply is incomplete")}
        {:error, error} -> {:error, error}
      end
    else
      {:ok, nil} -> :ok
      error -> error
    end
  end

  defp filter({:stream, _}), do: %{}
  defp filter(subject), do: %{"filter" => name(subject)}

  @impl true
  def subjects(%__MODULE__{} = log), do: Kept.all(log, log.stream <> "_S_", log.stream <> "_KEYS")

  @impl true
  def delete(%__MODULE__{} = log, {:stream, _} = subject),
    do: Kept.delete(log, stream(log, subject))

  def delete(%__MODULE__{} = log, subject),
    do: Kept.purge(log, stream(log, subject), name(subject))

  @impl true
  def limit(%__MODULE__{} = log) do
    payload = (Connection.info(log.connection) || %{})["max_payload"] || 1_048_576
    max(payload - @reserve, 1_024)
  end

  @impl true
  def close(%__MODULE__{} = log) do
    GenServer.stop(log.connection)
  catch
    :exit, _ -> :ok
  end

  defp stream(log, {:stream, name}), do: log.stream <> "_S_" <> short(token(name))
  defp stream(log, {:key, _}), do: log.stream <> "_KEYS"

  # A name becomes a single token, so that its characters cannot change the structure of the subject.
  defp name({:stream, name}), do: "situ.s." <> token(name)
  defp name({:key, name}), do: "situ.k." <> token(name)

  # The name of a JetStream stream is also a folder name, limited to 255 characters.
  defp short(token) when byte_size(token) <= 200, do: String.replace(token, "%", "=")
  defp short(token), do: Base.encode16(:crypto.hash(:sha256, token), case: :lower)

  defp token(name) do
    URI.encode(name, fn c -> c in ?a..?z or c in ?A..?Z or c in ?0..?9 or c in [?_, ?-] end)
  end
end
