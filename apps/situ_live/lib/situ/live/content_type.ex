defmodule Situ.Live.ContentType do
  @moduledoc false
  # Content types of the files that a page consists of.
  @types %{
    ".html" => "text/html; charset=utf-8",
    ".css" => "text/css; charset=utf-8",
    ".js" => "text/javascript; charset=utf-8",
    ".mjs" => "text/javascript; charset=utf-8",
    ".map" => "application/json",
    ".json" => "application/json",
    ".txt" => "text/plain; charset=utf-8",
    ".md" => "text/plain; charset=utf-8",
    ".svg" => "image/svg+xml",
    ".png" => "image/png",
    ".jpg" => "image/jpeg",
    ".jpeg" => "image/jpeg",
    ".gif" => "image/gif",
    ".webp" => "image/webp",
    ".ico" => "image/x-icon",
    ".woff2" => "font/woff2",
    ".wasm" => "application/wasm",
    ".wav" => "audio/wav",
    ".mp4" => "video/mp4",
    ".webm" => "video/webm"
  }

  @spec content_type(Path.t()) :: String.t()
  def content_type(path) do
    Map.get(@types, path |> Path.extname() |> String.downcase(), "application/octet-stream")
  end
end
