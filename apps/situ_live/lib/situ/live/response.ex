defmodule Situ.Live.Response do
  @moduledoc false
  # The response of a handler: status, headers, body.
  #
  # A body is iodata, or `{:file, path, offset, length}` (sent by the operating system), or
  # `{:chunks, enumerable}`. The server adds `content-length` or chunking, and the security
  # headers.
  alias Situ.Live.{ContentType, Request}

  defstruct status: 200, headers: [], body: ""

  @type body ::
          iodata()
          | {:file, Path.t(), non_neg_integer(), non_neg_integer()}
          | {:chunks, Enumerable.t()}
  @type t :: %__MODULE__{status: 100..599, headers: [{String.t(), String.t()}], body: body()}

  @doc "Builds a plain text response."
  @spec text(iodata(), 100..599) :: t()
  def text(text, status \\ 200), do: with_type(status, "text/plain; charset=utf-8", text)

  @doc "Builds a response from HTML that is already escaped."
  @spec html(iodata(), 100..599) :: t()
  def html(html, status \\ 200), do: with_type(status, "text/html; charset=utf-8", html)

  @doc """
  Builds a JSON response from maps, lists, strings, numbers, booleans and `nil`.

      iex> Situ.Live.Response.json(%{"ok" => true}).status
      200
  """
  @spec json(term(), 100..599) :: t()
  def json(value, status \\ 200),
    do: with_type(status, "application/json", Situ.JSON.encode(value))

  @doc "Builds a response from bytes, with additional `headers`."
  @spec binary(iodata(), [{String.t(), String.t()}]) :: t()
  def binary(bytes, headers \\ []) do
    %__MODULE__{headers: [{"content-type", "application/octet-stream"} | headers], body: bytes}
  end

  @doc "Builds a redirect to a path or URL; raises if it contains a line break."
  @spec redirect(String.t(), 300..399) :: t()
  def redirect(to, status \\ 302) do
    if :binary.match(to, ["\r", "\n"]) != :nomatch,
      do: raise(ArgumentError, "a redirect target must be one line, got: #{inspect(to)}")

    %__MODULE__{status: status, headers: [{"location", to}]}
  end

  @doc "Builds a one-line error page."
  @spec error(100..599, String.t()) :: t()
  def error(status, message \\ ""),
    do: text([Integer.to_string(status), " ", message, "\n"], status)

  defp with_type(status, type, body) do
    %__MODULE__{status: status, headers: [{"content-type", type}], body: body}
  end

  @doc "Sets a header; replaces an earlier value."
  @spec put_header(t(), String.t(), String.t()) :: t()
  def put_header(%__MODULE__{headers: headers} = response, name, value) do
    %{response | headers: List.keystore(headers, name, 0, {name, value})}
  end

  @doc """
  Builds a response with a file, or with the part that the request's `range` header selects. The status is `304` if the
  browser already has the file.

  Options: `:type` (default: derived from the file extension), `:cache` (the `cache-control` header, default
  `"no-cache"`: the browser revalidates each time, and the server returns `304` if nothing changed).
  """
  @spec file(Request.t(), Path.t(), keyword()) :: t()
  def file(%Request{} = request, path, opts \\ []) do
    case File.stat(path, time: :posix) do
      {:ok, %File.Stat{type: :regular, size: size, mtime: mtime}} ->
        etag = ~s("#{Integer.to_string(mtime, 36)}-#{Integer.to_string(size, 36)}")

        headers = [
          {"content-type", opts[:type] || ContentType.content_type(path)},
          {"cache-control", opts[:cache] || "no-cache"},
          {"etag", etag}
        ]

        serve_range(request, size, headers, fn from, length -> {:file, path, from, length} end)

      _ ->
        error(404, "not found")
    end
  end

  @doc """
  Builds a response with stored content of `size` bytes, or with the part that the request's `range` header selects
  (`206`, `416`). `read.(from, length)` returns a part of the content.

      iex> request = %Situ.Live.Request{headers: %{"range" => "bytes=1-2"}}
      iex> response = Situ.Live.Response.serve_range(request, 4, [], fn from, n -> binary_part("abcd", from, n) end)
      iex> {response.status, response.body, List.keyfind(response.headers, "content-range", 0)}
      {206, "bc", {"content-range", "bytes 1-2/4"}}
  """
  @spec serve_range(
          Request.t(),
          non_neg_integer(),
          [{String.t(), String.t()}],
          (non_neg_integer(), non_neg_integer() ->
             body())
        ) :: t()
  def serve_range(%Request{} = request, size, headers, body_part) do
    headers = [{"accept-ranges", "bytes"} | headers]
    {_, etag} = List.keyfind(headers, "etag", 0, {"etag", nil})

    cond do
      etag != nil and etag_matches?(Request.get_header(request, "if-none-match"), etag) ->
        %__MODULE__{status: 304, headers: headers}

      Request.get_header(request, "if-range") not in [nil, etag] ->
        %__MODULE__{headers: headers, body: body_part.(0, size)}

      true ->
        range_response(
          parse_range(Request.get_header(request, "range"), size),
          size,
          headers,
          body_part
        )
    end
  end

  defp range_response(:all, size, headers, body_part),
    do: %__MODULE__{headers: headers, body: body_part.(0, size)}

  defp range_response({from, to}, size, headers, body_part) do
    headers = [{"content-range", "bytes #{from}-#{to}/#{size}"} | headers]
    %__MODULE__{status: 206, headers: headers, body: body_part.(from, to - from + 1)}
  end

  defp range_response(:unsatisfiable, size, _headers, _read) do
    %__MODULE__{status: 416, headers: [{"content-range", "bytes */#{size}"}]}
  end

  defp etag_matches?(nil, _), do: false
  defp etag_matches?("*", _), do: true

  defp etag_matches?(tags, etag) do
    tags |> String.split(",") |> Enum.any?(&(&1 |> String.trim() |> String.trim("W/") == etag))
  end

  # Only a single byte range is supported; otherwise the full content is returned (RFC 9110, 14.2).
  defp parse_range("bytes=" <> spec, size) do
    case Regex.run(~r/\A(\d{0,18})-(\d{0,18})\z/, spec, capture: :all_but_first) do
      ["", ""] -> :all
      ["", last] -> suffix_range(String.to_integer(last), size)
      [from, ""] -> bounded_range(String.to_integer(from), size - 1, size)
      [from, to] -> bounded_range(String.to_integer(from), String.to_integer(to), size)
      nil -> :all
    end
  end

  defp parse_range(_, _), do: :all

  defp suffix_range(0, _size), do: :unsatisfiable
  defp suffix_range(_, 0), do: :unsatisfiable
  defp suffix_range(last, size), do: {max(size - last, 0), size - 1}

  defp bounded_range(from, _to, size) when from >= size, do: :unsatisfiable
  defp bounded_range(from, to, _size) when to < from, do: :all
  defp bounded_range(from, to, size), do: {from, min(to, size - 1)}
end
