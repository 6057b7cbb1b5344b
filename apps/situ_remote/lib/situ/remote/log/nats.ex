defmodule Situ.Remote.Log.Nats do
  @moduledoc """
  The log of several machines and sites: NATS JetStream (a `nats-server -js` of 2.9 or newer, one or a cluster).

      {:ok, log} = Situ.Remote.Log.connect("nats://10.0.0.1:4222,10.0.0.2:4222", replicas: 3)

  Entries are messages of two JetStream streams, which are made when they are not there: `SITU` (subjects
  `situ.s.NAME`) and `SITU_KEYS` (`situ.k.NAME`, the last message of each). `Nats-Expected-Last-Subject-Sequence` is the
  condition of a write, the header `Situ-Op` its name. A server that is lost is looked for again, in the list and in
  turn; meanwhile everything answers `{:error, %Situ.Error{code: :log_away}}`, and may be tried again as it is.

  The address may hold `user:password@` or `token@`. Sequence numbers are the stream's: a subject's grow, with gaps.

  ## Options

  """
  @behaviour Situ.Remote.Log

  alias Situ.{Error, JSON, Options}
  alias Situ.Remote.Log.Entry
  alias Situ.Remote.Log.Nats.Connection

  @schema [
    replicas: [type: {:range, 1, 5}, default: 1, doc: "On how many servers each entry is."],
    stream: [type: :string, default: "SITU", doc: "The name of the JetStream stream."],
    max_bytes: [type: :pos_integer, doc: "Retention: the oldest entries go beyond that ..."],
    max_age: [type: :pos_integer, doc: "... or when they are older, ns."],
    when_full: [
      type: {:in, [:drop_oldest, :refuse]},
      default: :drop_oldest,
      doc: "With `max_bytes`: `:refuse` answers an error (`:log_full`) instead."
    ],
    tls: [
      type: {:optional, :keyword},
      doc: "Options of `:ssl`: TLS is used, and the server's name checked."
    ],
    timeout: [type: :pos_integer, default: 2_000, doc: "Ms to wait for an answer."]
  ]
  @moduledoc @moduledoc <> Options.docs(@schema)

  @enforce_keys [:connection, :stream, :timeout]
  defstruct [:connection, :stream, :timeout]

  @type t :: %__MODULE__{connection: pid(), stream: String.t(), timeout: pos_integer()}

  # Headers of an entry, and what the server adds.
  @reserve 8_192

  @impl true
  def connect(address, opts) do
    with {:ok, opts} <- Options.validate(opts, @schema),
         {:ok, servers, login} <- parse(address),
         {:ok, connection} <- start(servers: servers, login: login, tls: opts[:tls]),
         log = %__MODULE__{connection: connection, stream: opts[:stream], timeout: opts[:timeout]},
         :ok <- made(log, opts) do
      {:ok, log}
    end
  end

  defp start(opts) do
    case Connection.start(opts) do
      {:ok, connection} ->
        {:ok, connection}

      {:error, {:shutdown, %Error{} = error}} ->
        {:error, error}

      {:error, reason} ->
        {:error, Error.new(:log_away, "no connection: #{inspect(reason, limit: 5)}")}
    end
  end

  @doc false
  @spec parse(String.t()) ::
          {:ok, [{String.t(), :inet.port_number()}], map()} | {:error, Error.t()}
  def parse("nats://" <> rest = address) do
    {login, hosts} =
      case String.split(rest, "@", parts: 2) do
        [hosts] -> {%{}, hosts}
        [login, hosts] -> {login(String.split(login, ":", parts: 2)), hosts}
      end

    servers = hosts |> String.split(",", trim: true) |> Enum.map(&server/1)

    if servers == [] or :error in servers,
      do:
        {:error,
         Error.new(:bad_address, "not an address: #{redacted(address)}",
           fix: "write nats://host:4222"
         )},
      else: {:ok, servers, login}
  end

  defp login([user, password]), do: %{"user" => URI.decode(user), "pass" => URI.decode(password)}
  defp login([token]), do: %{"auth_token" => URI.decode(token)}

  defp server(text) do
    case String.split(text, ":") do
      [host] when host != "" ->
        {host, 4222}

      [host, port] when host != "" ->
        with({n, ""} <- Integer.parse(port), do: {host, n}, else: (_ -> :error))

      _ ->
        :error
    end
  end

  defp redacted(address), do: String.replace(address, ~r{//[^@]*@}, "//...@")

  # Two servers, or two nodes, may make it at once: the second one finds it there.
  defp made(log, opts) do
    common = %{"storage" => "file", "num_replicas" => opts[:replicas], "allow_direct" => true}
    discard = if opts[:when_full] == :refuse, do: "new", else: "old"

    entries =
      Map.merge(common, %{
        "name" => log.stream,
        "subjects" => ["situ.s.>"],
        "discard" => discard,
        "max_bytes" => opts[:max_bytes] || -1,
        "max_age" => opts[:max_age] || 0
      })

    keys =
      Map.merge(common, %{
        "name" => log.stream <> "_KEYS",
        "subjects" => ["situ.k.>"],
        "max_msgs_per_subject" => 1
      })

    with :ok <- made_one(log, entries), do: made_one(log, keys)
  end

  defp made_one(log, config) do
    case ask(log, "$JS.API.STREAM.INFO." <> config["name"], "", 10_000) do
      {:ok, %{"config" => _}} ->
        :ok

      {:ok, %{"error" => %{"err_code" => 10_059}}} ->
        case ask(log, "$JS.API.STREAM.CREATE." <> config["name"], JSON.encode(config), 10_000) do
          {:ok, %{"config" => _}} -> :ok
          {:ok, %{"error" => %{"err_code" => 10_058}}} -> :ok
          {:ok, %{"error" => error}} -> {:error, refusal(error)}
          {:error, error} -> {:error, error}
        end

      {:ok, %{"error" => error}} ->
        {:error, refusal(error)}

      {:error, error} ->
        {:error, error}
    end
  end

  @impl true
  def append(%__MODULE__{} = log, subject, expected, %Entry{} = entry) do
    headers =
      [
        {"Nats-Expected-Last-Subject-Sequence", Integer.to_string(expected)},
        {"Situ-Op", entry.op}
      ] ++
        for({key, value} <- entry.head, do: {"Situ-" <> key, value})

    with :ok <- fits(log, entry),
         {:ok, answer} <- request(log, name(subject), headers, entry.data, log.timeout) do
      appended(answer, log, subject, entry)
    end
  end

  # Somebody else, or ourselves: then only the acknowledgement was lost.
  defp appended(%{"error" => %{"err_code" => 10_071}}, log, subject, %{op: op}) do
    case last(log, subject) do
      {:ok, %Entry{op: ^op, seq: seq}} -> {:ok, seq}
      {:ok, last} -> {:refused, last}
      {:error, error} -> {:error, error}
    end
  end

  defp appended(%{"error" => error}, _log, _subject, _entry), do: {:error, refusal(error)}

  defp appended(%{"seq" => seq}, _log, _subject, _entry) when seq > 0, do: {:ok, seq}

  defp appended(_answer, _log, _subject, _entry),
    do: {:error, away("an answer that says nothing")}

  defp fits(log, entry) do
    size = :erlang.iolist_size(entry.data)

    if size <= limit(log),
      do: :ok,
      else:
        {:error,
         Error.new(
           :too_large,
           "an entry of #{size} bytes; the server takes #{limit(log)} at most",
           why: "a larger one would make it close the connection",
           fix: "raise max_payload in the server's configuration, or write less at once"
         )}
  end

  # Asked of the stream's leader: a replica may not have it yet.
  @impl true
  def last(%__MODULE__{} = log, subject) do
    body = JSON.encode(%{"last_by_subj" => name(subject)})

    case ask(log, "$JS.API.STREAM.MSG.GET." <> stream(log, subject), body) do
      {:ok, %{"message" => message}} -> decoded(message)
      {:ok, %{"error" => %{"err_code" => 10_037}}} -> {:ok, nil}
      {:ok, %{"error" => error}} -> {:error, refusal(error)}
      {:ok, _other} -> {:error, away("an answer that says nothing")}
      {:error, error} -> {:error, error}
    end
  end

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
      _ -> {:error, away("an answer that is no Base64")}
    end
  end

  defp entry(headers, data, seq) do
    {op, headers} = Map.pop(headers, "Situ-Op", "")
    head = for {"Situ-" <> key, value} <- headers, into: %{}, do: {key, value}
    %Entry{seq: seq, op: op, head: head, data: data}
  end

  @impl true
  def read(%__MODULE__{} = log, subject, from, most), do: read(log, subject, from, most, [])

  defp read(_log, _subject, _from, 0, entries), do: {:ok, Enum.reverse(entries)}

  defp read(log, subject, from, most, entries) do
    body = JSON.encode(%{"seq" => from, "next_by_subj" => name(subject)})
    target = "$JS.API.DIRECT.GET." <> stream(log, subject)

    case Connection.request(log.connection, target, [], body, log.timeout) do
      {:ok, %{status: status}} when status in ["404", "408"] ->
        {:ok, Enum.reverse(entries)}

      {:ok, %{status: "503"}} ->
        {:error, away("no JetStream answers")}

      {:ok, %{headers: %{"Nats-Sequence" => seq} = headers, data: data}} ->
        entry = entry(headers, data, String.to_integer(seq))
        read(log, subject, entry.seq + 1, most - 1, [entry | entries])

      {:ok, _other} ->
        {:error, away("an answer that says nothing")}

      {:error, reason} ->
        {:error, away(reason)}
    end
  end

  @impl true
  def trim(%__MODULE__{} = log, subject, seq) do
    with {:ok, %Entry{} = last} <- last(log, subject) do
      body = JSON.encode(%{"filter" => name(subject), "seq" => min(seq, last.seq)})

      case ask(log, "$JS.API.STREAM.PURGE." <> stream(log, subject), body) do
        {:ok, %{"success" => true}} -> :ok
        {:ok, %{"error" => error}} -> {:error, refusal(error)}
        {:ok, _} -> {:error, away("an answer that says nothing")}
        {:error, error} -> {:error, error}
      end
    else
      {:ok, nil} -> :ok
      error -> error
    end
  end

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

  # Requests

  defp ask(log, subject, body, timeout \\ nil),
    do: request(log, subject, [], body, timeout || log.timeout)

  defp request(log, subject, headers, data, timeout) do
    case Connection.request(log.connection, subject, headers, data, timeout) do
      {:ok, %{status: "503"}} ->
        {:error, away("no JetStream answers: it has no leader, or not enough servers")}

      {:ok, %{data: body}} ->
        with {:error, _} <- JSON.decode(body), do: {:error, away("an answer that is no JSON")}

      {:error, reason} ->
        {:error, away(reason)}
    end
  end

  defp away(:down), do: away("the connection is down")
  defp away(:timeout), do: away("it does not answer")

  defp away(why) do
    Error.new(:log_away, "the log is away: #{why}",
      why: "the last write may or may not have arrived",
      fix: "repeat the same write: nothing is written twice"
    )
  end

  # 10047, 10077, 10122: no space, as the stream's or the account's limits say.
  defp refusal(%{"err_code" => code} = error) when code in [10_023, 10_047, 10_077, 10_122] do
    Error.new(:log_full, "the log is full: #{error["description"]}",
      fix: "raise max_bytes or the server's limits, or trim the log"
    )
  end

  defp refusal(error) do
    description = error["description"] || "unknown error"
    Error.new(:log_failed, "the NATS server says: #{description} (#{error["err_code"]})")
  end

  defp stream(log, {:stream, _}), do: log.stream
  defp stream(log, {:key, _}), do: log.stream <> "_KEYS"

  # One token each: whatever a name holds, it is no part of the subject's structure.
  defp name({:stream, name}), do: "situ.s." <> token(name)
  defp name({:key, name}), do: "situ.k." <> token(name)

  defp token(name) do
    URI.encode(name, fn c -> c in ?a..?z or c in ?A..?Z or c in ?0..?9 or c in [?_, ?-] end)
  end
end
