defmodule Situ.Infer.Service do
  @own [
    key: [
      type: {:optional, :string},
      default: nil,
      doc: "The **name** of the environment variable that contains the key; `nil` sends no key."
    ],
    retries: [
      type: :non_neg_integer,
      default: 2,
      doc: "How often a request is retried after a temporary failure."
    ],
    backoff: [
      type: :pos_integer,
      default: 500,
      doc: "The delay before the first retry, in ms; it doubles each time, up to 30 s."
    ],
    most_bytes: [
      type: :pos_integer,
      default: 32_000_000,
      doc: "The maximum size of a response."
    ]
  ]
  @schema @own ++ Situ.Infer.Http.schema()

  @moduledoc """
  Sends a request to a network service and returns the complete response. Speech and vision services share this module
  (built on `Situ.Infer.Http`); for services that stream their responses, use `Situ.Chat`.

      {:ok, service} = Situ.Infer.Service.new("https://api.openai.com/v1", key: "OPENAI_API_KEY")
      json = [{"content-type", "application/json"}]
      {:ok, %{body: body}} = Situ.Infer.Service.post(service, "/audio/speech", json, request)

  Keys are read from the environment when they are sent, and are never in options, states, errors, logs or URLs. A key
  is sent only over TLS or to this machine.

  ## Options

  #{Situ.Options.docs(@schema)}

  ## Errors

  The errors of `Situ.Infer.Http`, and `:not_private`, `:no_key`, `:refused` (the service rejects the request, for
  example because of an invalid key or an unknown model), `:service_failed` (a temporary failure), `:too_long`.
  """
  alias Situ.Error
  alias Situ.Infer.Http

  @enforce_keys [:url, :opts, :header]
  defstruct @enforce_keys
  @type t :: %__MODULE__{url: String.t(), opts: map(), header: :bearer | String.t()}
  @type answer :: %{status: 200..299, headers: %{String.t() => String.t()}, body: binary()}

  @longest_wait_ms 30_000
  @complaint_bytes 65_536
  @again [408, 409, 425, 429, 500, 502, 503, 504, 529]

  @doc "Returns the schema of the options, for modules that pass them on."
  @spec schema() :: Situ.Options.schema()
  def schema, do: @schema

  @doc """
  Builds a service at a URL, without connecting. `header` selects how the key is sent: `:bearer`, or the name of a
  separate header.
  """
  @spec new(String.t(), keyword(), :bearer | String.t()) :: {:ok, t()} | {:error, Error.t()}
  def new(url, opts, header \\ :bearer) do
    with {:ok, opts} <- Situ.Options.validate(opts, @schema),
         {:ok, parsed} <- Http.parse_url(url),
         :ok <- check_transport(parsed, opts[:key]),
         do:
           {:ok,
            %__MODULE__{url: String.trim_trailing(url, "/"), opts: Map.new(opts), header: header}}
  end

  @doc "Checks that a key may be sent to a URL: over TLS, or to this machine."
  @spec check_transport(Http.url(), String.t() | nil) :: :ok | {:error, Error.t()}
  def check_transport(_url, nil), do: :ok
  def check_transport(%{scheme: :https}, _key), do: :ok

  def check_transport(url, _key) do
    if Http.local_host?(url) do
      :ok
    else
      {:error,
       Error.new(:not_private, "a key is not sent to #{url.host} over http",
         why: "other machines on the network could read it",
         fix: "use https://"
       )}
    end
  end

  @doc "Returns the key in the environment variable `name`. Error: `:no_key`."
  @spec fetch_key(String.t()) :: {:ok, String.t()} | {:error, Error.t()}
  def fetch_key(name) do
    case System.get_env(name) do
      key when key in [nil, ""] ->
        {:error,
         Error.new(:no_key, "the environment variable #{name} is not set",
           fix: "set it to the key of the service before the program starts"
         )}

      key ->
        {:ok, key}
    end
  end

  @doc """
  Removes a key from an error, in case the service repeated it. A truncated key at the end of the text is removed, too.

      iex> error = Situ.Error.new(:refused, "sk-123 is wrong, not sk-1")
      iex> Situ.Infer.Service.redact_key(error, "sk-123").what
      "*** is wrong, not ***"
  """
  @spec redact_key(Error.t(), String.t()) :: Error.t()
  def redact_key(error, key) do
    what = String.replace(error.what, key, "***")
    cut = Enum.find(byte_size(key)..4//-1, &String.ends_with?(what, binary_part(key, 0, &1)))
    what = if cut, do: binary_part(what, 0, byte_size(what) - cut) <> "***", else: what
    %{error | what: what}
  end

  @doc """
  Appends a path to the path of a URL, before the query string.

      iex> Situ.Infer.Service.join_path("https://models.example/openai/gpt/?api-version=1", "/chat/completions")
      "https://models.example/openai/gpt/chat/completions?api-version=1"
  """
  @spec join_path(String.t(), String.t()) :: String.t()
  def join_path(url, path) do
    case String.split(url, "?", parts: 2) do
      [url] -> String.trim_trailing(url, "/") <> path
      [url, query] -> String.trim_trailing(url, "/") <> path <> "?" <> query
    end
  end

  @doc "Returns the delay before the next retry in ms; half of it is random, so that clients do not all retry together."
  @spec retry_delay_ms(pos_integer(), non_neg_integer()) :: pos_integer()
  def retry_delay_ms(backoff, tries) do
    most = min(backoff * Integer.pow(2, min(tries, 16)), @longest_wait_ms)
    div(most, 2) + :rand.uniform(div(most, 2) + 1)
  end

  @doc "Sends `body` to `path` (appended to the service's URL) and waits for the complete response."
  @spec post(t(), String.t(), [Http.header()], iodata()) :: {:ok, answer()} | {:error, Error.t()}
  def post(%__MODULE__{} = service, path, headers, body) do
    case key_header(service) do
      {:ok, nil, []} ->
        post_with_retries(service, path, headers, body, 0)

      {:ok, key, own} ->
        with {:error, error} <- post_with_retries(service, path, own ++ headers, body, 0),
             # The service may repeat the key it was sent.
             do: {:error, redact_key(error, key)}

      error ->
        error
    end
  end

  defp key_header(%{opts: %{key: nil}}), do: {:ok, nil, []}

  defp key_header(%{opts: %{key: name}, header: header}) do
    with {:ok, key} <- fetch_key(name) do
      if header == :bearer,
        do: {:ok, key, [{"authorization", "Bearer " <> key}]},
        else: {:ok, key, [{header, key}]}
    end
  end

  defp post_with_retries(service, path, headers, body, tries) do
    case post_once(service, path, headers, body) do
      {:again, wait, _error} when tries < service.opts.retries ->
        # The calling component waits here, as it would wait for the response.
        Process.sleep(wait || retry_delay_ms(service.opts.backoff, tries))
        post_with_retries(service, path, headers, body, tries + 1)

      {:again, _wait, error} ->
        {:error, error}

      result ->
        result
    end
  end

  defp post_once(%{opts: opts} = service, path, headers, body) do
    limits = Keyword.new(Map.take(opts, Keyword.keys(Http.schema())))
    reply = %{status: nil, headers: %{}, body: [], bytes: 0, most: opts.most_bytes}

    case Http.request(:post, service.url <> path, headers, body, limits, &collect_reply/2, reply) do
      {:ok, reply} ->
        check_status(reply)

      {:error, %{code: code} = error, _} when code in [:no_connection, :timeout, :cut_off] ->
        {:again, nil, error}

      {:error, error, _} ->
        {:error, error}
    end
  end

  defp collect_reply({:status, status, headers}, reply) do
    most = if status in 200..299, do: reply.most, else: @complaint_bytes
    {:cont, %{reply | status: status, headers: Map.new(headers), most: most}}
  end

  defp collect_reply({:data, bytes}, reply) do
    reply = %{reply | body: [reply.body, bytes], bytes: reply.bytes + byte_size(bytes)}
    if reply.bytes > reply.most, do: {:halt, reply}, else: {:cont, reply}
  end

  defp check_status(%{status: status} = reply) when status in 200..299 do
    if reply.bytes > reply.most,
      do:
        {:error,
         Error.new(:too_long, "the response of the service is too long",
           fix: "increase most_bytes:"
         )},
      else:
        {:ok, %{status: status, headers: reply.headers, body: IO.iodata_to_binary(reply.body)}}
  end

  defp check_status(%{status: status}) when status in [401, 403] do
    # The service's message about a key might contain the key, so it is left out.
    {:error,
     Error.new(:refused, "the service rejected the key (HTTP #{status})",
       fix: "set the variable named by key: to a key that is permitted to use this service"
     )}
  end

  defp check_status(%{status: status} = reply) do
    said = error_suffix(IO.iodata_to_binary(reply.body))

    if status in @again do
      what = "the service could not process the request (HTTP #{status})#{said}"
      {:again, retry_after_ms(reply.headers), Error.new(:service_failed, what)}
    else
      {:error,
       Error.new(:refused, "the service rejected the request (HTTP #{status})#{said}",
         fix: "check the URL and the options"
       )}
    end
  end

  defp error_suffix(body) do
    with {:ok, json} <- Situ.JSON.decode(body),
         text when is_binary(text) <- error_message(json) do
      ": " <> String.slice(text, 0, 300)
    else
      _ -> ""
    end
  end

  defp error_message(%{"error" => %{"message" => text}}), do: text
  defp error_message(%{"error" => text}), do: text
  defp error_message(%{"message" => text}), do: text
  defp error_message(_), do: nil

  defp retry_after_ms(%{"retry-after" => text}) do
    case Integer.parse(text) do
      {s, ""} when s >= 0 -> min(s * 1_000, @longest_wait_ms)
      _ -> nil
    end
  end

  defp retry_after_ms(_headers), do: nil
end
