defmodule Situ.Infer.Service do
  @moduledoc false
  # A network service: its URL, the key, the time limits and the retries. All requests to speech,
  # vision and language services use this module, which is built on `Situ.Infer.Http`.
  #
  # Keys are read from the environment when they are sent, and are never in options, states,
  # errors, logs or URLs. A key is sent only over TLS or to this machine.

  @schema [
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
          ] ++ Situ.Infer.Http.schema()

  alias Situ.Error
  alias Situ.Infer.{Http, Service.Refusal}

  @enforce_keys [:url, :opts, :header]
  defstruct @enforce_keys
  @type t :: %__MODULE__{url: String.t(), opts: map(), header: :bearer | String.t()}

  @typedoc """
  Reads a successful response as it arrives. `add` receives the events of `Situ.Infer.Http.request/7` with the
  accumulator, which starts as `initial`. `finish` receives the accumulator, and the error that ended the response
  early or `nil`. Its result `{:retry, error}` allows another attempt if the error is temporary.
  """
  @type reader :: %{
          initial: term(),
          add: (Http.event(), term() -> {:cont | :halt, term()}),
          finish: (term(), Error.t() | nil -> {:ok, term()} | {:error | :retry, Error.t()})
        }

  @longest_wait_ms 30_000
  # The codes of errors that another attempt may avoid.
  @temporary [:no_connection, :timeout, :cut_off]

  @doc """
  Returns the schema of the options, for modules that pass them on. `key` is the default of the option `key:`.
  """
  @spec schema(String.t() | nil) :: Situ.Options.schema()
  def schema(key \\ nil) do
    key = [
      key: [
        type: {:optional, :string},
        default: key,
        doc: "The **name** of the environment variable that contains the key; `nil` sends no key."
      ]
    ]

    key ++ @schema
  end

  @doc "Returns the error codes of a service as text, for the documentation of modules that use one."
  @spec describe_errors() :: String.t()
  def describe_errors do
    "`:no_key` (the environment variable is not set), `:not_private` (a key would be sent without TLS), `:refused` " <>
      "(an invalid key or an unknown model, for example), `:service_failed` (a temporary failure), `:bad_url`, " <>
      "`:bad_header`, `:no_connection`, `:not_trusted` (the certificate), `:timeout`, `:cut_off`, `:bad_response`, " <>
      "`:too_long`"
  end

  @doc """
  Builds a service at a URL, without connecting. `header` selects how the key is sent: `:bearer`, or the name of a
  separate header. `opts` may contain other options, which the calling module has validated.
  """
  @spec new(String.t(), keyword(), :bearer | String.t()) :: {:ok, t()} | {:error, Error.t()}
  def new(url, opts, header \\ :bearer) do
    with {:ok, opts} <-
           opts |> Keyword.take(Keyword.keys(schema())) |> Situ.Options.validate(schema()),
         {:ok, parsed} <- Http.parse_url(url),
         :ok <- check_transport(parsed, opts[:key]),
         do: {:ok, %__MODULE__{url: url, opts: Map.new(opts), header: header}}
  end

  defp check_transport(_url, nil), do: :ok
  defp check_transport(%{scheme: :https}, _key), do: :ok

  defp check_transport(url, _key) do
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

  @doc "Sends `body` to `path` (appended to the service's URL) and returns the body of the complete response."
  @spec post(t(), String.t(), [Http.header()], iodata()) ::
          {:ok, binary()} | {:error, Error.t()}
  def post(%__MODULE__{opts: %{most_bytes: most}} = service, path, headers, body) do
    stream(service, path, headers, body, %{
      initial: {[], 0},
      add: &collect_body(&1, &2, most),
      finish: &finish_body(&1, &2, most)
    })
  end

  defp collect_body({:status, _status, _headers}, acc, _most), do: {:cont, acc}

  defp collect_body({:data, bytes}, {body, size}, most) do
    size = size + byte_size(bytes)
    {if(size > most, do: :halt, else: :cont), {[body, bytes], size}}
  end

  defp finish_body(_acc, %Error{} = error, _most), do: {:retry, error}

  defp finish_body({_body, size}, nil, most) when size > most do
    {:error,
     Error.new(:too_long, "the response of the service is too long",
       why: "it has more than #{most} bytes",
       fix: "increase most_bytes:"
     )}
  end

  defp finish_body({body, _size}, nil, _most), do: {:ok, IO.iodata_to_binary(body)}

  @doc "Sends `body` to `path` (appended to the service's URL) and passes a successful response to `reader`."
  @spec stream(t(), String.t(), [Http.header()], iodata(), reader()) ::
          {:ok, term()} | {:error, Error.t()}
  def stream(%__MODULE__{} = service, path, headers, body, reader) do
    with {:ok, key, key_headers} <- fetch_key(service) do
      request = %{url: join_path(service.url, path), headers: key_headers ++ headers, body: body}

      # The service may repeat the key it was sent.
      with {:error, error} <- request_with_retries(service.opts, request, reader, 0),
           do: {:error, redact_key(error, key)}
    end
  end

  defp fetch_key(%{opts: %{key: nil}}), do: {:ok, nil, []}

  defp fetch_key(%{opts: %{key: name}, header: header}) do
    case System.get_env(name) do
      key when key in [nil, ""] ->
        {:error,
         Error.new(:no_key, "the environment variable #{name} is not set",
           fix: "set it to the key of the service before the program starts"
         )}

      key when header == :bearer ->
        {:ok, key, [{"authorization", "Bearer " <> key}]}

      key ->
        {:ok, key, [{header, key}]}
    end
  end

  defp request_with_retries(opts, request, reader, tries) do
    case send_request(opts, request, reader) do
      {:retry, delay, _error} when tries < opts.retries ->
        # The calling process waits here, as it would wait for the response.
        Process.sleep(delay || retry_delay_ms(opts.backoff, tries))
        request_with_retries(opts, request, reader, tries + 1)

      {:retry, _delay, error} ->
        {:error, error}

      result ->
        result
    end
  end

  defp send_request(opts, request, reader) do
    limits = Keyword.new(Map.take(opts, Keyword.keys(Http.schema())))
    add = &add_event(&1, &2, reader)
    start = {:accepted, reader.initial}

    case Http.request(:post, request.url, request.headers, request.body, limits, add, start) do
      {:ok, {:accepted, acc}} -> acc |> reader.finish.(nil) |> check_retry()
      {:ok, {:refused, refusal}} -> check_refusal(refusal)
      {:error, error, {:accepted, acc}} -> acc |> reader.finish.(error) |> check_retry()
      {:error, error, {:refused, _refusal}} -> check_retry({:retry, error})
    end
  end

  defp add_event({:status, status, headers}, _acc, _reader) when status not in 200..299,
    do: {:cont, {:refused, Refusal.new(status, headers)}}

  defp add_event({:data, bytes}, {:refused, refusal}, _reader) do
    {next, refusal} = Refusal.add_bytes(refusal, bytes)
    {next, {:refused, refusal}}
  end

  defp add_event(event, {:accepted, acc}, reader) do
    {next, acc} = reader.add.(event, acc)
    {next, {:accepted, acc}}
  end

  defp check_retry({:retry, %{code: code} = error}) when code in @temporary,
    do: {:retry, nil, error}

  defp check_retry({:retry, error}), do: {:error, error}
  defp check_retry(result), do: result

  defp check_refusal(refusal) do
    error = Refusal.build_error(refusal)

    if Refusal.temporary?(refusal),
      do: {:retry, Refusal.retry_after_ms(refusal, @longest_wait_ms), error},
      else: {:error, error}
  end

  # Half of the delay is random, so that clients do not all retry together.
  defp retry_delay_ms(backoff, tries) do
    most = min(backoff * Integer.pow(2, min(tries, 16)), @longest_wait_ms)
    div(most, 2) + :rand.uniform(div(most, 2) + 1)
  end

  @doc """
  Removes a key from an error, in case the service repeated it. A truncated key at the end of the text is removed, too.

      iex> error = Situ.Error.new(:refused, "sk-123 is wrong, not sk-1")
      iex> Situ.Infer.Service.redact_key(error, "sk-123").what
      "*** is wrong, not ***"
  """
  @spec redact_key(Error.t(), String.t() | nil) :: Error.t()
  def redact_key(error, nil), do: error

  def redact_key(error, key) do
    what = String.replace(error.what, key, "***")
    cut = Enum.find(byte_size(key)..4//-1, &String.ends_with?(what, binary_part(key, 0, &1)))
    what = if cut, do: binary_part(what, 0, byte_size(what) - cut) <> "***", else: what
    %{error | what: what}
  end

  @doc """
  Appends a path, which may have a query, to the path of a URL, before the query of the URL.

      iex> Situ.Infer.Service.join_path("https://models.example/openai/gpt/?api-version=1", "/chat/completions")
      "https://models.example/openai/gpt/chat/completions?api-version=1"
  """
  @spec join_path(String.t(), String.t()) :: String.t()
  def join_path(url, path) do
    case String.split(url, "?", parts: 2) do
      [url] ->
        String.trim_trailing(url, "/") <> path

      [url, query] ->
        sign = if String.contains?(path, "?"), do: "&", else: "?"
        String.trim_trailing(url, "/") <> path <> sign <> query
    end
  end

  @doc "Builds the error for a response that does not follow the service's protocol."
  @spec bad_answer() :: Error.t()
  def bad_answer do
    Error.new(:bad_answer, "the service's response has an unexpected format",
      fix: "check the URL; it may belong to a different kind of service"
    )
  end
end
