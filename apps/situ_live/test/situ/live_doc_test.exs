defmodule Situ.Live.DocTest do
  use ExUnit.Case, async: true

  doctest Situ.Live.Html
  doctest Situ.Live.JS
  doctest Situ.Live.Query
  doctest Situ.Live.Request
  doctest Situ.Live.Response
  doctest Situ.Live.Route
  doctest Situ.Live.Token
end
