defmodule Situ.Chat.Model do
  @moduledoc false
  # A language model on an OpenAI-compatible service (`Situ.Infer.Service`).

  @own [
    url: [
      type: :string,
      default: "http://127.0.0.1:11434/v1",
      doc:
        "The URL of the service; `/chat/completions` is appended to its path, before any query (`?api-version=...`)."
    ],
    model: [type: :string, required: true, doc: "The name of the model."],
    key_header: [
      type: {:in, [:bearer, :api_key]},
      default: :bearer,
      doc: "How the key is sent: `authorization: Bearer`, or `api-key` (Azure)."
    ],
    temperature: [
      type: {:optional, {:range, 0, 2}},
      default: nil,
      doc: "The sampling temperature; `nil` uses the service's default."
    ],
    max_tokens: [
      type: {:optional, :pos_integer},
      default: nil,
      doc: "The maximum number of tokens in one answer."
    ],
    usage: [
      type: :boolean,
      default: true,
      doc: "Ask for token counts; use `false` for services that reject this option."
    ],
    retries: [
      type: :non_neg_integer,
      default: 3,
      doc: "How often a request that failed before its first output is retried."
    ]
  ]
  @schema @own ++ Keyword.drop(Situ.Infer.Service.schema(), [:retries, :most_bytes])

  alias Situ.Chat.{Answer, ResponseReader, Tool, Turn}
  alias Situ.Error
  alias Situ.Infer.Service

  @enforce_keys [:service, :opts]
  defstruct @enforce_keys
  @type t :: %__MODULE__{service: Service.t(), opts: map()}

  @doc "Returns the schema of the options, for modules that forward them."
  @spec schema() :: Situ.Options.schema()
  def schema, do: @schema

  @doc "Builds a model from its options, without connecting."
  @spec new(keyword()) :: {:ok, t()} | {:error, Error.t()}
  def new(opts) do
    with {:ok, opts} <- Situ.Options.validate(opts, @schema),
         {:ok, service} <- Service.new(opts[:url], opts, key_header(opts[:key_header])),
         do: {:ok, %__MODULE__{service: service, opts: Map.new(opts)}}
  end

  defp key_header(:bearer), do: :bearer
  defp key_header(:api_key), do: "api-key"

  @doc """
  Sends all turns of a conversation, and calls `emit_text` with each chunk of text as it arrives. Errors: the errors of
  `Situ.Infer.Service`.
  """
  @spec ask(t(), [Turn.t()], [Tool.t()], (String.t() -> any())) ::
          {:ok, Answer.t()} | {:error, Error.t()}
  def ask(%__MODULE__{} = model, turns, tools, emit_text) do
    headers = [{"content-type", "application/json"}, {"accept", "text/event-stream"}]
    body = Situ.JSON.encode(build_body(model.opts, turns, tools))

    # A retry blocks only the process of this question, which is killed when the question is cancelled.
    Service.stream(model.service, "/chat/completions", headers, body, %{
      initial: ResponseReader.new(),
      add: &add_event(&1, &2, emit_text),
      finish: &ResponseReader.build_result/2
    })
  end

  defp add_event(event, reader, emit_text) do
    {next, texts, reader} = ResponseReader.add_event(reader, event)
    Enum.each(texts, emit_text)
    {next, reader}
  end

  defp build_body(opts, turns, tools) do
    %{
      model: opts.model,
      stream: true,
      messages: Enum.map(turns, &Turn.to_json/1),
      temperature: opts.temperature,
      max_tokens: opts.max_tokens,
      stream_options: if(opts.usage, do: %{include_usage: true}),
      tools: if(tools != [], do: Enum.map(tools, &Tool.to_json/1))
    }
    |> Map.reject(fn {_, value} -> value == nil end)
  end
end
