defmodule Situ.Cluster.Log.Nats.Api do
  @moduledoc false
  # Sends JSON requests to JetStream, decodes its JSON replies, and converts the server's errors to `Situ.Error`.
  alias Situ.{Error, JSON}
  alias Situ.Cluster.Log.Nats
  alias Situ.Link.Nats.Connection

  @api_ms 10_000

  @doc "Returns the settings and state of a JetStream stream, or the error `:no_stream` if it does not exist."
  @spec stream_info(Nats.t(), String.t(), pos_integer()) :: {:ok, map()} | {:error, Error.t()}
  def stream_info(log, name, timeout \\ @api_ms) do
    case request_json(log, log.api <> "STREAM.INFO." <> name, "", timeout) do
      {:ok, %{"config" => _} = info} -> {:ok, info}
      {:ok, %{"error" => error}} -> {:error, server_error(error)}
      {:ok, _other} -> {:error, unreachable_error("the reply is incomplete")}
      {:error, error} -> {:error, error}
    end
  end

  @doc "Creates a JetStream stream. Returns `:ok` if another client has just created it."
  @spec create_stream(Nats.t(), map()) :: :ok | {:error, Error.t()}
  def create_stream(log, %{"name" => name} = config) do
    case request_json(log, log.api <> "STREAM.CREATE." <> name, JSON.encode(config), @api_ms) do
      {:ok, %{"config" => _}} -> :ok
      {:ok, %{"error" => %{"err_code" => 10_058}}} -> :ok
      {:ok, %{"error" => error}} -> {:error, server_error(error)}
      {:ok, _other} -> {:error, unreachable_error("the reply is incomplete")}
      {:error, error} -> {:error, error}
    end
  end

  @doc "Changes the settings of a JetStream stream."
  @spec update_stream(Nats.t(), map()) :: :ok | {:error, Error.t()}
  def update_stream(log, %{"name" => name} = config) do
    case request_json(log, log.api <> "STREAM.UPDATE." <> name, JSON.encode(config), @api_ms) do
      {:ok, %{"config" => _}} -> :ok
      {:ok, %{"error" => error}} -> {:error, server_error(error)}
      {:ok, _other} -> {:error, unreachable_error("the reply is incomplete")}
      {:error, error} -> {:error, error}
    end
  end

  @doc "Sends a request and returns its reply."
  @spec request_json(Nats.t(), String.t(), iodata(), pos_integer() | nil) ::
          {:ok, term()} | {:error, Error.t()}
  def request_json(log, subject, body, timeout \\ nil),
    do: log |> try_request(subject, [], body, timeout || log.timeout) |> reject_silence()

  @spec reject_silence(:silent | {:ok, term()} | {:error, Error.t()}) ::
          {:ok, term()} | {:error, Error.t()}
  def reject_silence(:silent),
    do:
      {:error,
       unreachable_error(
         "JetStream is not responding: it has no leader, or too few servers are running"
       )}

  def reject_silence(result), do: result

  @doc """
  Sends a request with headers, as `request_json/4` does. Returns `:silent` if the server has no responder for it.
  """
  @spec try_request(Nats.t(), String.t(), [{String.t(), String.t()}], iodata(), pos_integer()) ::
          {:ok, term()} | :silent | {:error, Error.t()}
  def try_request(log, subject, headers, data, timeout) do
    case Connection.request(log.connection, subject, headers, data, timeout) do
      {:ok, %{status: "503"}} ->
        :silent

      {:ok, %{data: body}} ->
        with {:error, _} <- JSON.decode(body),
             do: {:error, unreachable_error("the reply is not valid JSON")}

      {:error, reason} ->
        {:error, unreachable_error(reason)}
    end
  end

  @doc "Builds the error for a log that is temporarily unreachable."
  @spec unreachable_error(:down | :timeout | String.t()) :: Error.t()
  def unreachable_error(:down), do: unreachable_error("the connection is down")
  def unreachable_error(:timeout), do: unreachable_error("it did not reply in time")

  def unreachable_error(why) do
    Error.new(:log_away, "the log is unreachable: #{why}",
      why: "the last write may or may not have succeeded",
      fix: "repeat the same write: nothing is written twice"
    )
  end

  @doc "Converts an error of the server to a `Situ.Error`."
  @spec server_error(map()) :: Error.t()
  # 10047, 10077 and 10122 mean that the limits of the stream or the account leave no space.
  def server_error(%{"err_code" => code} = error) when code in [10_023, 10_047, 10_077, 10_122] do
    Error.new(:log_full, "the log is full: #{error["description"]}",
      fix: "raise max_bytes or the server's limits, or trim the log"
    )
  end

  def server_error(%{"err_code" => 10_059} = error),
    do: Error.new(:no_stream, "the NATS server reported: #{error["description"]}")

  # 10049: the folder could not be created, mostly for lack of file handles. 10026, 10027: the account limit is reached.
  def server_error(%{"err_code" => code} = error) when code in [10_026, 10_027, 10_049] do
    Error.new(:log_full, "the NATS server cannot create another stream: #{error["description"]}",
      fix: "raise its limit of open files (two per stream), or the account's max_streams"
    )
  end

  def server_error(error) do
    description = error["description"] || "unknown error"
    Error.new(:log_failed, "the NATS server reported: #{description} (#{error["err_code"]})")
  end
end
