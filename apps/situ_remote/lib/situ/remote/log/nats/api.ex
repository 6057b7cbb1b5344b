defmodule Situ.Remote.Log.Nats.Api do
  @moduledoc false
  # Questions to JetStream and its answers, JSON both; errors of the server as ours.
  alias Situ.{Error, JSON}
  alias Situ.Remote.Log.Nats
  alias Situ.Remote.Log.Nats.Connection

  @api_ms 10_000

  @doc "A JetStream stream's settings and state; `:no_stream` when there is none."
  @spec info(Nats.t(), String.t(), pos_integer()) :: {:ok, map()} | {:error, Error.t()}
  def info(log, name, timeout \\ @api_ms) do
    case ask(log, log.api <> "STREAM.INFO." <> name, "", timeout) do
      {:ok, %{"config" => _} = info} -> {:ok, info}
      {:ok, %{"error" => error}} -> {:error, refusal(error)}
      {:ok, _other} -> {:error, away("an answer that says nothing")}
      {:error, error} -> {:error, error}
    end
  end

  @doc "Makes a JetStream stream. Of two that do so at once the second one finds it there."
  @spec made(Nats.t(), map()) :: :ok | {:error, Error.t()}
  def made(log, %{"name" => name} = config) do
    case ask(log, log.api <> "STREAM.CREATE." <> name, JSON.encode(config), @api_ms) do
      {:ok, %{"config" => _}} -> :ok
      {:ok, %{"error" => %{"err_code" => 10_058}}} -> :ok
      {:ok, %{"error" => error}} -> {:error, refusal(error)}
      {:ok, _other} -> {:error, away("an answer that says nothing")}
      {:error, error} -> {:error, error}
    end
  end

  @doc "Changes the settings of a JetStream stream."
  @spec change_stream(Nats.t(), map()) :: :ok | {:error, Error.t()}
  def change_stream(log, %{"name" => name} = config) do
    case ask(log, log.api <> "STREAM.UPDATE." <> name, JSON.encode(config), @api_ms) do
      {:ok, %{"config" => _}} -> :ok
      {:ok, %{"error" => error}} -> {:error, refusal(error)}
      {:ok, _other} -> {:error, away("an answer that says nothing")}
      {:error, error} -> {:error, error}
    end
  end

  @doc "A question and its answer."
  @spec ask(Nats.t(), String.t(), iodata(), pos_integer() | nil) ::
          {:ok, term()} | {:error, Error.t()}
  def ask(log, subject, body, timeout \\ nil),
    do: log |> answer(subject, [], body, timeout || log.timeout) |> heard()

  @spec heard(:silent | {:ok, term()} | {:error, Error.t()}) ::
          {:ok, term()} | {:error, Error.t()}
  def heard(:silent),
    do: {:error, away("no JetStream answers: it has no leader, or not enough servers")}

  def heard(answer), do: answer

  @doc "As `ask/4`, with headers; `:silent` when nobody is there who could answer."
  @spec answer(Nats.t(), String.t(), [{String.t(), String.t()}], iodata(), pos_integer()) ::
          {:ok, term()} | :silent | {:error, Error.t()}
  def answer(log, subject, headers, data, timeout) do
    case Connection.request(log.connection, subject, headers, data, timeout) do
      {:ok, %{status: "503"}} ->
        :silent

      {:ok, %{data: body}} ->
        with {:error, _} <- JSON.decode(body), do: {:error, away("an answer that is no JSON")}

      {:error, reason} ->
        {:error, away(reason)}
    end
  end

  @doc "The log does not answer for the time being."
  @spec away(:down | :timeout | String.t()) :: Error.t()
  def away(:down), do: away("the connection is down")
  def away(:timeout), do: away("it does not answer")

  def away(why) do
    Error.new(:log_away, "the log is away: #{why}",
      why: "the last write may or may not have arrived",
      fix: "repeat the same write: nothing is written twice"
    )
  end

  @doc "An error of the server as ours."
  @spec refusal(map()) :: Error.t()
  # 10047, 10077, 10122: no space, as the stream's or the account's limits say.
  def refusal(%{"err_code" => code} = error) when code in [10_023, 10_047, 10_077, 10_122] do
    Error.new(:log_full, "the log is full: #{error["description"]}",
      fix: "raise max_bytes or the server's limits, or trim the log"
    )
  end

  def refusal(%{"err_code" => 10_059} = error),
    do: Error.new(:no_stream, "the NATS server says: #{error["description"]}")

  # 10049: its folder could not be made, mostly for lack of handles; 10026, 10027: as many as the account may have.
  def refusal(%{"err_code" => code} = error) when code in [10_026, 10_027, 10_049] do
    Error.new(:log_full, "the NATS server takes no further stream: #{error["description"]}",
      fix: "raise its limit of open files (two a stream), or the account's max_streams"
    )
  end

  def refusal(error) do
    description = error["description"] || "unknown error"
    Error.new(:log_failed, "the NATS server says: #{description} (#{error["err_code"]})")
  end
end
