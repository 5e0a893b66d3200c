//! deblur
